"""Primitives that depend on shapes against XLA: shapes, axes and values that hypothesis draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from tests.engine.native.probe import PATHS, Named, Probe, both

# The derivative of a NaN extreme is 1 / 0 times a mask: NaN, of which XLA's CPU code may make 0.
MASKED = ("max", "min")
SPECIAL = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-42, 1.0])


def problem(rng):
    """(name -> function, name -> shapes): one of every kind, with a shape and an axis of its own."""
    functions, shapes = {}, {}

    def integer(low, high):
        return int(rng.integers(low, high + 1))

    def add(name, function, *given):
        functions[name], shapes[name] = (lambda t, *x: function(*x)), tuple(given)

    def some():
        s = tuple(map(int, rng.choice([1, 2, 3, 4, 7], integer(1, 3))))
        return s, integer(0, len(s) - 1)

    for kind, f in {
        "sum": jnp.sum, "prod": jnp.prod, "max": jnp.max, "min": jnp.min, "mean": jnp.mean,
        "argmax": jnp.argmax, "argmin": jnp.argmin, "any": lambda x, axis: jnp.any(x > 0.3, axis),
        "all": lambda x, axis: jnp.all(x > -1.5, axis), "cumsum": jnp.cumsum, "cumprod": jnp.cumprod,
        "cummax": jax.lax.cummax, "cummin": jax.lax.cummin, "sort": jnp.sort, "argsort": jnp.argsort,
        "flip": jnp.flip, "softmax": jax.nn.softmax, "logsumexp": jax.nn.logsumexp, "diff": lambda x, axis: jnp.diff(x, axis=axis) if x.shape[axis] > 1 else x,
        "reverse_cumsum": lambda x, axis: jax.lax.cumsum(x, axis, reverse=True),
    }.items():  # fmt: skip
        s, axis = some()
        add(kind, lambda x, f=f, axis=axis: f(x, axis=axis), s)

    s, axis = some()
    other = tuple(integer(1, 5) if i == axis else n for i, n in enumerate(s))
    add("concatenate", lambda a, b, i=axis: jnp.concatenate([a, jnp.tanh(b), a], i), s, other)
    s, axis = some()
    add("stack", lambda a, b, i=axis: jnp.stack([a, b, a * b], i), s, s)
    s, axis = some()
    order = tuple(map(int, rng.permutation(len(s))))
    add("transpose", lambda x, o=order: (jnp.transpose(x, o) * 2).reshape(-1), s)
    s, axis = some()
    rows = [slice(integer(0, n - 1), None, integer(1, 3)) for n in s]
    add("slice", lambda x, r=tuple(rows): x[r] * 2, s)
    s, axis = some()
    config = [(integer(-1, 2), integer(0, 2), 0) for _ in s]
    add("pad", lambda x, c=config: jax.lax.pad(x, jnp.asarray(0.5, x.dtype), c), s)
    s, axis = some()
    config = [(integer(0, 2), integer(0, 2), integer(0, 2)) for _ in s]
    add("pad_between", lambda x, c=config: jax.lax.pad(x, jnp.asarray(-1, x.dtype), c), s)
    s, axis = some()
    reps = tuple(integer(1, 3) for _ in s)
    add("tile", lambda x, r=reps: jnp.tile(x, r), s)
    s, axis = some()
    at = integer(0, s[axis])
    add("split", lambda x, i=axis, a=at: jnp.concatenate(jnp.split(x, [a], i)[::-1], i), s)
    s, axis = some()
    add(
        "unstack",
        lambda x, i=axis: sum(jnp.sin(k * y) for k, y in enumerate(jnp.unstack(x, axis=i))),
        s,
    )
    s, axis = some()
    picks = rng.integers(-9, 10, integer(1, 4))
    mode = str(rng.choice(["fill", "clip"]))
    add("take", lambda x, p=picks, i=axis, m=mode: jnp.take(x, p, i, mode=m), s)
    s, axis = some()
    add(
        "take_moving", lambda x, i=axis, m=mode: jnp.take(x, whole(x.reshape(-1)[:2]), i, mode=m), s
    )
    s, axis = some()
    size = tuple(integer(1, n) for n in s)
    add(
        "dynamic_slice",
        lambda x, z=size: jax.lax.dynamic_slice(x, list(whole(jnp.resize(x, x.ndim))), z),
        s,
    )
    add(
        "dynamic_update",
        lambda x, y: jax.lax.dynamic_update_slice(x, y, list(whole(jnp.resize(y, x.ndim)))),
        s,
        size,
    )
    for kind in ("add", "multiply", "min", "max", "set"):
        s, axis = some()
        # Distinct positions, some beyond the end: what is set twice has no defined order.
        where = rng.permutation(
            np.arange(-min(2, s[0]), s[0]) % s[0] if kind == "add" else s[0] + 2
        )
        where = where[: integer(1, 3)]
        add(f"scatter_{kind}", lambda x, k=kind, w=where: scattered(x, w, k), s)
    s, axis = some()
    add("scatter_moving", lambda x: x.at[whole(x.reshape(-1)[:3])].add(x.reshape(-1)[0]), s)
    m, k, n, b = map(int, rng.choice([1, 2, 3, 5, 8, 17], 4))
    b = min(b, 3)
    add("matmul", jnp.matmul, (m, k), (k, n))
    add("batched", jnp.matmul, (b, m, k), (b, k, n))
    add("contracted", lambda x, y: jnp.einsum("ijk,kjl->li", x, y), (m, b, k), (k, b, n))
    add("outer", lambda x, y: jnp.einsum("i,jk->jik", x, y), (m,), (k, b))
    add("matvec", lambda x, y: x @ y, (m, k), (k,))
    functions["shared"] = lambda t, x: jnp.resize(t, (n, k)) @ x
    shapes["shared"] = ((k,),)
    s, axis = some()
    add("broadcast", lambda x, y, i=axis: x * jnp.sum(y, i, keepdims=True) + y, s, s)
    add("where_rows", lambda x, i=axis: jnp.where(x > jnp.max(x, i, keepdims=True) - 1, x, -x), s)
    return functions, shapes


def whole(x):
    """Positions from numbers: some within an array, some beyond; none for what is not finite."""
    return jnp.clip(jnp.nan_to_num(x) * 3, -4, 9).astype(jnp.int32)


def scattered(x, where, kind: str):
    if kind in ("min", "max"):  # JAX has no derivative of these
        return getattr(jax.lax.stop_gradient(x).at[where], kind)(0.1)
    return getattr(x.at[where], kind)(jnp.tanh(x[0]), unique_indices=True)


@pytest.mark.parametrize(
    ("precision", "tolerance", "examples"),
    [
        ("float64", 1e-10, 12),
        ("float32", 2e-4, 12),
    ],
)
@pytest.mark.slow
def test_shapes(precision, tolerance, examples):
    """Most paths have usual numbers, apart from one another; eleven have a special one or two."""

    @settings(deadline=None, max_examples=examples, database=None, phases=[Phase.generate])
    @given(st.integers(0, 2**31))
    def check(seed):
        rng = np.random.default_rng(seed)
        functions, shapes = problem(rng)
        x = {}
        for name, given_shapes in shapes.items():
            x[name] = [rng.uniform(-2.4, 2.4, (PATHS, *s)) for s in given_shapes]
            for array in x[name]:
                for path in range(22, PATHS):
                    flat = array[path].reshape(-1)
                    flat[rng.integers(flat.size, size=2)] = rng.choice(SPECIAL[name in MASKED :], 2)
        both(Probe(Named(functions), Named(shapes)), x, precision, tolerance, table=False)

    check()
