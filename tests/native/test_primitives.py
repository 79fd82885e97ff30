"""Every primitive and its derivative against XLA, on values that hypothesis draws, special ones too."""

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from snapo.engine import Window, Xla
from snapo.engine.native import Native
from snapo.policy import Constant
from snapo.scenarios import Pseudo
from snapo.simulator import Box, Schedule, Simulator
from snapo.smooth import Exact

PATHS = 33


class Probe(Simulator):
    """Applies functions to arrays in the state; each has inputs of its own, so none disturbs another."""

    functions: dict = eqx.field(static=True)
    shapes: dict = eqx.field(static=True)
    horizon: int = eqx.field(static=True, default=1)
    action: Box = eqx.field(default=Box(1))
    noise_size: int = eqx.field(static=True, default=0)

    def prepare(self, inputs):
        return Schedule(
            {"table": jnp.linspace(-1.0, 2.0, 40) ** 2}, {"day": jnp.zeros(self.horizon)}
        )

    def initial(self, constants, noise):
        inputs = {name: [jnp.zeros(s) for s in self.shapes[name]] for name in self.functions}
        results = {name: jnp.zeros(r.shape, r.dtype) for name, r in self.results(constants).items()}
        return {"x": inputs, "y": results}

    def results(self, constants):
        return {
            name: jax.eval_shape(f, constants["table"], *(jnp.zeros(s) for s in self.shapes[name]))
            for name, f in self.functions.items()
        }

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        y = {name: f(constants["table"], *state["x"][name]) for name, f in self.functions.items()}
        total = sum(jnp.sum(r) for r in y.values() if jnp.issubdtype(r.dtype, jnp.floating))
        return {"x": state["x"], "y": y}, {"total": total}


def hashable(functions: dict) -> dict:
    return _Frozen(functions)


class _Frozen(dict):
    def __hash__(self):
        return hash(tuple(self))


def run(engine, probe: Probe, x: dict):
    """Results and gradients of every function, path by path."""
    with engine.numbers():
        schedule = probe.prepare(None)
        results = probe.results(schedule.constants)
        start = {
            "x": x,
            "y": {name: np.zeros((PATHS, *r.shape), r.dtype) for name, r in results.items()},
        }
    draws = Pseudo(0, False).draws(np.arange(PATHS), probe)
    args = (probe, Constant(0.0), schedule, draws, Exact())
    keyed = {"window": Window(0, 1), "start": start}
    values = engine.values(*args, **keyed).state["y"]
    gradient = engine.adjoint(*args, {"total": np.ones(PATHS)}, **keyed)
    return values, gradient.start["x"], gradient.schedule.constants["table"]


def same(expected, found, tolerance: float, name: str) -> None:
    """Equal to rounding, and NaN and infinity where XLA has them."""
    a, b = np.asarray(expected), np.asarray(found)
    assert a.shape == b.shape and a.dtype == b.dtype, name
    if a.dtype.kind != "f":
        np.testing.assert_array_equal(a, b, err_msg=name)
        return
    np.testing.assert_array_equal(np.isnan(a), np.isnan(b), err_msg=name)
    infinite = np.isinf(a) | np.isinf(b)
    largest = np.finfo(a.dtype).max / 4
    near = infinite & (np.where(np.isinf(a), largest, np.abs(a)) >= largest)
    np.testing.assert_array_equal(a[infinite & ~near], b[infinite & ~near], err_msg=name)
    usual = np.isfinite(a) & np.isfinite(b)
    np.testing.assert_allclose(b[usual], a[usual], tolerance, tolerance / 10, err_msg=name)


def both(probe: Probe, x: dict, precision: str, tolerance: float) -> None:
    x = {name: [a.astype(precision) for a in arrays] for name, arrays in x.items()}
    expected = run(Xla(precision), probe, x)
    found = run(Native(precision), probe, x)
    for name in probe.functions:
        same(expected[0][name], found[0][name], tolerance, name)
        for a, b in zip(expected[1][name], found[1][name]):
            same(a, b, tolerance, f"derivative of {name}")


UNARY = {
    "exp": jnp.exp, "log": jnp.log, "log1p": jnp.log1p, "expm1": jnp.expm1, "tanh": jnp.tanh,
    "sigmoid": jax.nn.sigmoid, "softplus": jax.nn.softplus, "silu": jax.nn.silu, "relu": jax.nn.relu,
    "sqrt": jnp.sqrt, "abs": jnp.abs, "sign": jnp.sign, "floor": jnp.floor, "ceil": jnp.ceil,
    "round": jnp.round, "square": jnp.square, "cube": lambda x: x**3, "inverse": lambda x: x**-2,
    "reciprocal": lambda x: 1 / x, "rsqrt": jax.lax.rsqrt, "neg": lambda x: -x, "isfinite": jnp.isfinite,
    "isnan": jnp.isnan, "positive": lambda x: x > 0, "nan_to_num": jnp.nan_to_num, "exp2": jnp.exp2,
    "erf": jax.scipy.special.erf, "erfc": jax.scipy.special.erfc, "sinh": jnp.sinh, "cosh": jnp.cosh,
    "clip": lambda x: jnp.clip(x, -0.5, 0.5), "where": lambda x: jnp.where(x < 1, x * 2, 3.0),
    "third": lambda x: x / 3, "atan": jnp.arctan, "cbrt": jnp.cbrt, "gelu": jax.nn.gelu,
}  # fmt: skip
BINARY = {
    "add": jnp.add, "sub": jnp.subtract, "mul": jnp.multiply, "div": jnp.divide, "max": jnp.maximum,
    "min": jnp.minimum, "atan2": jnp.arctan2, "less": jnp.less, "equal": jnp.equal, "not_equal": jnp.not_equal,
    "logaddexp": jnp.logaddexp, "select": lambda a, b: jnp.where(a > b, a, b * 2),
    "both": lambda a, b: jnp.logical_and(a > 0, b > 0) | ~(a < b),
}  # fmt: skip


def _elementwise() -> Probe:
    functions = {name: (lambda t, x, f=f: f(x)) for name, f in UNARY.items()}
    functions |= {name: (lambda t, a, b, f=f: f(a, b)) for name, f in BINARY.items()}
    shapes = {name: ((1,),) for name in UNARY} | {name: ((1,), (1,)) for name in BINARY}
    return Probe(hashable(functions), hashable(shapes))


SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -0.5, 2.0, 1e-3, -1e-3])
elementwise = _elementwise()


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-5), ("float64", 1e-11)])
def test_elementwise(precision, tolerance):
    """Numbers of moderate size and every pair of special values."""

    @settings(deadline=None, max_examples=12, database=None, phases=[Phase.generate])
    @given(
        hnp.arrays(
            np.float64, (2, PATHS), elements=st.floats(-8, 8, width=32, allow_subnormal=False)
        ),
        st.integers(0, 11),
    )
    def check(drawn, shift):
        pair = [drawn[0].copy(), drawn[1].copy()]
        pair[0][: len(SPECIAL)], pair[1][: len(SPECIAL)] = SPECIAL, np.roll(SPECIAL, shift)
        x = {name: [a[:, None] for a in pair[: len(s)]] for name, s in elementwise.shapes.items()}
        both(elementwise, x, precision, tolerance)

    check()


SMALL, BIG = (5,), (20,)
ARRAYS = {
    "sum": (lambda t, x: x.sum(), [BIG]),
    "sums": (lambda t, x: x.sum(axis=0) + x.mean(axis=1)[:3].sum(), [(6, 4)]),
    "product": (lambda t, x: jnp.prod(x), [SMALL]),
    "largest": (lambda t, x: x.max(), [BIG]),
    "smallest": (lambda t, x: x.min(axis=1), [(4, 5)]),
    "argmax": (lambda t, x: jnp.argmax(x), [SMALL]),
    "argmin": (lambda t, x: jnp.argmin(x), [BIG]),
    "all": (lambda t, x: jnp.all(x > -5) | jnp.any(x > 3), [BIG]),
    "cumsum": (lambda t, x: jnp.cumsum(x), [SMALL]),
    "cumsum_big": (lambda t, x: jnp.cumsum(x[::-1]), [BIG]),
    "cumprod": (lambda t, x: jnp.cumprod(x), [SMALL]),
    "cummax": (lambda t, x: jax.lax.cummax(x), [SMALL]),
    "concatenate": (lambda t, a, b: jnp.concatenate([a, b, a[:2]]), [SMALL, BIG]),
    "stack": (lambda t, a, b: jnp.stack([a, b], axis=1), [BIG, BIG]),
    "transpose": (lambda t, x: (x.T * jnp.arange(4)[:, None]).reshape(-1), [(6, 4)]),
    "strides": (lambda t, x: x[1:18:3] + x[::-1][:6], [BIG]),
    "pad": (lambda t, x: jnp.pad(x, ((1, 2), (0, 1)), constant_values=2.0), [(4, 5)]),
    "broadcast": (lambda t, a, b: a[:, None] * b[None, :], [SMALL, SMALL]),
    "split": (lambda t, x: jnp.split(x, 4)[2] * x[:5], [BIG]),
    "dot": (lambda t, a, b: jnp.dot(a, b), [BIG, BIG]),
    "matvec": (lambda t, a, b: a @ b, [(6, 5), SMALL]),
    "matmul": (lambda t, a, b: a @ b, [(4, 6), (6, 5)]),
    "batched": (lambda t, a, b: jnp.einsum("bij,bjk->bik", a, b), [(3, 2, 4), (3, 4, 2)]),
    "constant_matrix": (lambda t, a: jnp.cos(jnp.arange(200.0)).reshape(10, 20) @ a, [BIG]),
    "columns": (lambda t, a: a @ t.reshape(20, 2), [BIG]),
    "outer": (lambda t, a, b: jnp.outer(a, b) @ b, [BIG, BIG]),
    "sort": (lambda t, x: jnp.sort(x), [SMALL]),
    "sort_big": (lambda t, x: jnp.sort(x)[3:9], [BIG]),
    "argsort": (lambda t, x: jnp.argsort(x), [SMALL]),
    "index": (lambda t, x: x[jnp.array([3, 1, 1, 0])], [SMALL]),
    "set": (lambda t, x: x.at[2].set(x[0] * 2).at[1].add(3.0).at[-1].mul(2.0), [SMALL]),
    "set_big": (lambda t, x: x.at[4:7].add(x[:3]), [BIG]),
    "moving": (lambda t, x: x[jnp.argmax(x)] * x[jnp.clip(x[0].astype(int), 0, 4)], [SMALL]),
    "moving_big": (lambda t, x: jax.lax.dynamic_slice(x, (jnp.argmin(x),), (3,)), [BIG]),
    "moving_set": (lambda t, x: x.at[jnp.argmax(x)].set(0.0), [BIG]),
    "table": (lambda t, x: t[jnp.clip((x * 3).astype(int), 0, 39)], [SMALL]),
    "table_small": (lambda t, x: t[:6][jnp.clip(x.astype(int), -3, 9)], [SMALL]),
    "interp": (lambda t, x: jnp.interp(x, jnp.array([-1.0, 0.0, 0.5, 2.0]), jnp.array([0.0, 1.0, 3.0, 2.0])), [SMALL]),
    "interp_own": (lambda t, x, y: jnp.interp(x[0], jnp.array([-1.0, 0.0, 1.0, 2.0, 3.0]), y), [SMALL, SMALL]),
    "search": (lambda t, x: jnp.searchsorted(jnp.array([-1.0, 0.0, 1.0]), x, side="right"), [SMALL]),
    "loop": (lambda t, x: jax.lax.fori_loop(0, 6, lambda i, c: jnp.tanh(c * 0.9 + x * i), x), [SMALL]),
    "scan": (lambda t, x: jax.lax.scan(lambda c, y: (c + y, c * y), x[0], x)[1], [SMALL]),
    "cond": (lambda t, x: jax.lax.cond(x[0] > 0, lambda a: a * 2, lambda a: jnp.exp(a), x), [SMALL]),
    "switch": (lambda t, x: jax.lax.switch(x[0].astype(int), [jnp.sin, jnp.cos, jnp.tanh], x[1]), [SMALL]),
    "checkpoint": (lambda t, x: jax.checkpoint(lambda a: jnp.sin(jnp.sin(a)))(x), [BIG]),
    "custom": (lambda t, x: _doubled(x), [SMALL]),
    "softmax": (lambda t, x: jax.nn.softmax(x), [BIG]),
    "logsumexp": (lambda t, x: jax.nn.logsumexp(x), [BIG]),
    "norm": (lambda t, x: jnp.sqrt(jnp.sum(x**2) + 1.0), [BIG]),
    "integers": (lambda t, x: (x * 10).astype(int) // 3 - (x * 10).astype(int) % 4, [SMALL]),
    "bits": (lambda t, x: ((x * 10).astype(int) & 6) ^ ((x * 3).astype(int) << 1), [SMALL]),
    "unsigned": (lambda t, x: jnp.abs(x * 9).astype(jnp.uint32) >> 1, [SMALL]),
    "one_hot": (lambda t, x: jax.nn.one_hot(jnp.argmax(x), 5) * x, [SMALL]),
    "median": (lambda t, x: jnp.median(x), [SMALL]),
    "where_rows": (lambda t, x: jnp.where(x > x.mean(0), x, 0.0).sum(1), [(6, 4)]),
}  # fmt: skip


@jax.custom_vjp
def _doubled(x):
    return 2 * jnp.sin(x)


_doubled.defvjp(lambda x: (2 * jnp.sin(x), x), lambda x, g: (3 * g * x,))

arrays = Probe(
    hashable({name: f for name, (f, _) in ARRAYS.items()}),
    hashable({name: tuple(s) for name, (_, s) in ARRAYS.items()}),
)


@pytest.mark.parametrize(
    ("precision", "tolerance"),
    [pytest.param("float32", 1e-4, marks=pytest.mark.slow), ("float64", 1e-10)],
)
def test_arrays(precision, tolerance):
    """Numbers apart from one another, so that no order is decided by rounding."""

    @settings(deadline=None, max_examples=6, database=None, phases=[Phase.generate])
    @given(st.integers(0, 2**31))
    def check(seed):
        rng = np.random.default_rng(seed)
        x = {
            name: [rng.uniform(-2.4, 2.4, (PATHS, *s)) for s in shapes]
            for name, shapes in arrays.shapes.items()
        }
        x["cumprod"][0][:, 1] = 0
        both(arrays, x, precision, tolerance)

    check()
