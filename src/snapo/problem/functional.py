"""Weights and sampling errors of an objective that is one JAX function of the path totals.

Everything is computed in float64, within JAX's thread-local switch, and returned as NumPy.
Functions are compiled once per objective and number of paths.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from .code.version import Version, followed, of_formula, read_context

Formula = Callable[[Mapping[str, jax.Array]], jax.Array]
REFERENCE = 512  # paths of the sample with which a sensitivity curve is measured
AGREEMENT = 1e-9  # relative: a formula under weights against itself on repeated paths


@lru_cache(maxsize=64)
def compiled(objective, version: Version) -> tuple[Callable, Callable]:
    """The compiled formula of an objective, and the derivative with respect to every path total."""
    both = jax.jit(objective.formula), jax.jit(jax.grad(objective.formula))
    return followed(both[0], version), followed(both[1], version)


def value(objective, totals: Mapping[str, np.ndarray]) -> float:
    """The formula on these paths."""
    with jax.enable_x64(True):
        result = np.asarray(_known(objective, totals)[0](dict(totals)))
    if result.shape != ():
        raise TypeError(
            f"{type(objective).__name__}: the formula gives shape {result.shape}; an objective is "
            "one number, such as jnp.mean(x)."
        )
    return float(result)


def weights(objective, totals: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """d formula / d path total: {name: [N]}."""
    with jax.enable_x64(True):
        result = _known(objective, totals)[1](dict(totals))
        return {name: np.asarray(weight) for name, weight in result.items()}


def influence(objective, totals: Mapping[str, np.ndarray]) -> np.ndarray:
    """[N]: the value plus the empirical influence function of every path.

    The infinitesimal jackknife (Jaeckel 1972; Efron 1982, ch. 6): a path has the mass q_i / N in
    every sum over paths, and the influence is N dV/dq_i - sum_j dV/dq_j at q = 1.

    If the formula does not consist of sums over paths (but of a sort, for instance), N times a
    path's weight is the slope of the influence function at that path (von Mises 1947). For one
    output this slope is integrated along the sorted totals; for several, Tukey's sensitivity curve
    is used, n (V(x_1 … x_{n-1}, x) - V(x_1 … x_{n-1})), on n = 512 paths of the sample (Hampel et
    al. 1986, section 2.1e), with the sampling error of 512 paths. A single quantile has no smooth
    slope, and neither method is reliable for it. In all cases the mean of the result is shifted to
    the value.
    """
    totals, size = dict(totals), len(next(iter(totals.values())))
    centre = value(objective, totals)
    if size == 1:
        # One path has no sampling error, and the formula need not exist for a single path.
        return np.array([centre if np.isfinite(centre) else 0.0])
    with jax.enable_x64(True):
        mass = _by_mass(objective, totals, size)
        if mass is None:
            mass = (_by_slope if len(totals) == 1 else _by_curve)(objective, totals, size)
    return centre + mass - mass.mean()


def _by_mass(objective, totals, size: int) -> np.ndarray | None:
    """Derivatives with respect to the paths' masses, times N; None if masses do not represent
    paths."""
    version = of_formula(objective, totals)
    weighted, slopes = _massed_formula(objective, tuple(totals), size, version)
    # A mass of two must be the same as a path twice.
    selected = np.random.default_rng(0).integers(0, size, size)
    mass = np.bincount(selected, minlength=size).astype(np.float64)
    expected = value(objective, {name: total[selected] for name, total in totals.items()})
    try:
        result = weighted(mass, totals)
    except TypeError:  # a count of paths where only a whole number is allowed
        return None
    if not np.isclose(result, expected, rtol=AGREEMENT, atol=0.0, equal_nan=True):
        return None
    return size * np.asarray(slopes(np.ones(size), totals))


@lru_cache(maxsize=64)
def _massed_formula(
    objective, names: tuple[str, ...], size: int, version: Version
) -> tuple[Callable, Callable]:
    """The compiled formula of masses and totals, and its derivative with respect to the masses."""
    shape = jax.ShapeDtypeStruct((size,), np.float64)
    with read_context(version):
        closed = jax.make_jaxpr(objective.formula)(dict.fromkeys(names, shape))

    def weighted(mass, totals):
        leaves = jax.tree.leaves(totals)
        return _evaluate(closed.jaxpr, closed.consts, leaves, mass, size)[0]

    return jax.jit(weighted), jax.jit(jax.grad(weighted))


def _evaluate(jaxpr, consts, values, mass, size: int):
    """A formula's equations, with the paths' masses in every sum over an axis of paths."""
    env = dict(zip(jaxpr.constvars, consts)) | dict(zip(jaxpr.invars, values))
    for eqn in jaxpr.eqns:
        inputs = [a.val if isinstance(a, jex.Literal) else env[a] for a in eqn.invars]
        if (inner := called(eqn)) is not None:
            out = _evaluate(inner.jaxpr, inner.consts, inputs, mass, size)
        else:
            out = _results(eqn, _massed(eqn, inputs, mass, size))
        env.update(zip(eqn.outvars, out))
    return [a.val if isinstance(a, jex.Literal) else env[a] for a in jaxpr.outvars]


_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint")


def called(eqn) -> jex.ClosedJaxpr | None:
    """The program that an equation calls once, as that of a `jax.jit`; None for all others."""
    inner = next((eqn.params[k] for k in ("jaxpr", "call_jaxpr") if k in eqn.params), None)
    return inner if isinstance(inner, jex.ClosedJaxpr) and eqn.primitive.name in _CALLS else None


def _massed(eqn, values, mass, size: int):
    """The operands of an equation; those of a sum over paths are multiplied by the masses."""
    if eqn.primitive.name == "reduce_sum":
        axes = eqn.params["axes"]
    elif eqn.primitive.name == "dot_general":
        axes = eqn.params["dimension_numbers"][0][0]
    else:
        return values
    first = values[0]
    for axis in axes:
        if first.shape[axis] == size:
            shape = [size if i == axis else 1 for i in range(first.ndim)]
            first = first * mass.reshape(shape)  # a float, also if whole numbers are counted
    return [first, *values[1:]]


_COUNTS = (
    "add", "sub", "mul", "neg", "abs", "max", "min", "integer_pow", "square", "select_n",
    "eq", "ne", "lt", "le", "gt", "ge", "reduce_sum", "reduce_max", "reduce_min", "dot_general",
    "broadcast_in_dim", "reshape", "squeeze", "concatenate", "slice", "copy",
)  # fmt: skip


def _results(eqn, values) -> list:
    """The results of an equation. If an operand is a count of paths, which masses have made a
    float, all whole numbers become floats.

    **Raises:** `TypeError` for an equation that needs whole numbers.
    """
    params, name = eqn.primitive.get_bind_params(eqn.params), eqn.primitive.name
    if any(_is_float(value) and not _is_float(var.aval) for value, var in zip(values, eqn.invars)):
        if name == "convert_element_type":
            kind = params["new_dtype"]
            return [values[0].astype(jnp.float64 if jnp.issubdtype(kind, jnp.integer) else kind)]
        if name not in _COUNTS:
            raise TypeError(f"{name} of a count of paths")
        values = [
            jnp.asarray(value, jnp.float64) if _is_integer(value) else value for value in values
        ]
        if name == "dot_general":
            params |= {"preferred_element_type": np.dtype(np.float64)}
    out = eqn.primitive.bind(*values, **params)
    return out if eqn.primitive.multiple_results else [out]


def _is_integer(value) -> bool:
    return jnp.issubdtype(jnp.result_type(value), jnp.integer)


def _is_float(value) -> bool:
    return jnp.issubdtype(jnp.result_type(value), jnp.floating)


def _by_slope(objective, totals, size: int) -> np.ndarray:
    """The trapezoidal integral of N times the weights along the sorted totals of one output."""
    name, x = next(iter(totals.items()))
    slope = size * weights(objective, totals)[name]
    order = np.argsort(x, kind="stable")
    means = (slope[order][1:] + slope[order][:-1]) / 2
    result = np.empty(size)
    result[order] = np.append(0.0, np.cumsum(means * np.diff(x[order])))
    return result


def _by_curve(objective, totals, size: int) -> np.ndarray:
    """The sensitivity curve at every path, on an evenly chosen part of the sample."""
    selected = np.linspace(0, size - 1, min(size, REFERENCE) - 1).astype(int)
    sample = {name: total[selected] for name, total in totals.items()}

    def with_one_more(path):
        joined = {name: jnp.append(sample[name], path[name]) for name in sample}
        return objective.formula(joined)

    with read_context(of_formula(objective, totals)):
        many = jax.jit(lambda paths: jax.lax.map(with_one_more, paths, batch_size=1024))(totals)
    return (len(selected) + 1) * (np.asarray(many) - value(objective, sample))


def _known(objective, totals: Mapping[str, np.ndarray]) -> tuple[Callable, Callable]:
    try:
        return compiled(objective, of_formula(objective, dict(totals)))
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        raise TypeError(
            f"{type(objective).__name__}: {error}. The fields of an objective are numbers, names "
            "and tuples of them."
        ) from None
