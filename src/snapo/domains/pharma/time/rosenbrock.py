"""Rosenbrock steps for stiff units: L-stable, without Newton iterations, with an error estimate.

Rodas5P (Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks
within the Julia Differential Equations package, BIT Numerical Mathematics 63:27, 2023,
doi:10.1007/s10543-023-00967-x): 8 stages, order 5, stiffly accurate, R(infinity) = 0, with an
embedded method of order 4. With J = df/dy at the start of a step of h seconds, and f_t the
derivative with respect to time through the controls,

    (I - gamma h J) u_i = gamma (h f(y + sum_j a_ij u_j, t + c_i h) + sum_j C_ij u_j + d_i h^2 f_t),

the step ends at y + sum_j a_8j u_j + u_8, and u_8 is the estimate of its error. This is the form
without products of J and vectors (Hairer and Wanner, Solving Ordinary Differential Equations II,
section IV.7, equation 7.25), times h, so that a step of no length changes nothing.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, custom_jvp, jax, jnp

WRITTEN_OUT = 24  # unknowns above which LAPACK factorises, which the native engine does not have


class LUFactors(NamedTuple):
    """A matrix [m, m] in a form for solving: its inverse, or LAPACK's factors and pivots."""

    table: Float[Array, "m m"]
    pivots: Array | None


def factorised(matrix: Float[Array, "m m"]) -> LUFactors:
    """The factors of a matrix, without derivatives; `solve` has the derivatives."""
    matrix = jax.lax.stop_gradient(matrix)
    if len(matrix) <= WRITTEN_OUT:
        return LUFactors(_inverse(matrix), None)
    return LUFactors(*jax.scipy.linalg.lu_factor(matrix))


def _solve_tangent(primals, tangents):
    matrix, factors, right = primals
    d_matrix, _, d_right = tangents
    result = solve(matrix, factors, right)
    return result, solve(matrix, factors, d_right - d_matrix @ result)


@custom_jvp(_solve_tangent)
def solve(
    matrix: Float[Array, "m m"], factors: LUFactors, right: Float[Array, " m"]
) -> Float[Array, " m"]:
    """x with `matrix` x = `right`; its derivatives are those of the exact solution."""
    first = _apply(factors, right)
    return first + _apply(factors, right - matrix @ first)


def _apply(factors: LUFactors, right: Array) -> Array:
    if factors.pivots is None:
        return factors.table @ right
    return jax.scipy.linalg.lu_solve((factors.table, factors.pivots), right)


def _inverse(matrix: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """The inverse; non-finite where the matrix is singular."""
    size = len(matrix)
    table = jnp.concatenate([matrix, jnp.eye(size, dtype=matrix.dtype)], 1)
    for k in range(size):
        below = jnp.abs(table[:, k]) * (jnp.arange(size) >= k)
        selected = (jnp.arange(size) == jnp.argmax(below))[:, None]
        pivot = jnp.sum(jnp.where(selected, table, 0.0), 0)
        table = jnp.where(selected, table[k], table)
        pivot = pivot / pivot[k]
        here = (jnp.arange(size) == k)[:, None]
        table = jnp.where(here, pivot, table - table[:, k, None] * pivot)
    return table[:, size:]


GAMMA = 0.21193756319429014
_LAST = (
    -7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256,
    0.030198172008377946,
)  # fmt: skip
A = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    _LAST,
    (*_LAST, 1.0),
    (*_LAST, 1.0, 1.0),
)
C = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125,
     -0.6610691825249471),
    (30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783,
     -19.097331116725623, -28.087943162872662),
    (37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047,
     -40.06618937091002, -54.66780262877968, -9.48861652309627),
)  # fmt: skip
NODES = np.array(
    [0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0]
)
AT = (0, 1, 2, 3, 4, 5, 5, 5)  # which of the nodes each stage is at
BY_TIME = (
    0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734,
    2.325825639765069, 0.0, 0.0, 0.0,
)  # fmt: skip
# The same as square tables, with zeros elsewhere.
_TABLES = tuple(
    np.array([(*row, *[0.0] * (len(AT) - len(row))) for row in item]) for item in (A, C)
)
ORDER = 5  # of the step; its error estimate falls like the same power of its length

Rate = Callable[[Array, Array], Array]


class Push(NamedTuple):
    """The driving inputs over one step: `at` [6, D], their values at the `NODES` of the step;
    `bend` [D], their slope at its start, per length of the step."""

    at: Float[Array, "6 D"]
    bend: Float[Array, " D"]


def push(drive: Callable[..., Array], start: list[Array], end: list[Array]) -> Push:
    """The drive of a step over which every control is linear from `start` to `end`."""
    change = [b - a for a, b in zip(start, end)]
    nodes = jnp.asarray(NODES, jnp.result_type(float))
    at = drive(*(a + nodes * d for a, d in zip(start, change)))
    return Push(at, jax.jvp(drive, tuple(start), tuple(change))[1])


def rosenbrock(
    rate: Rate, y: Float[Array, " m"], step: Float[Array, ""], push: Push, scanned: bool = True
) -> tuple[Float[Array, " m"], Float[Array, " m"], Float[Array, "m m"]]:
    """y after a step of `step` seconds, the estimate of its error, and df/dy at its start.
    `scanned`: whether the stages are a loop, which compiles several times faster; the native
    engine needs them written out.
    """
    now = push.at[0]
    jacobian = jax.jacfwd(rate)(y, now)
    matrix = np.eye(len(y), dtype=y.dtype) - GAMMA * step * jacobian
    factors = factorised(matrix)
    bend = step * jax.jvp(lambda u: rate(y, u), (now,), (push.bend,))[1]

    def stage(point, drive, before, by_time) -> Array:
        right = step * rate(point, drive) + by_time * bend + before
        return solve(matrix, factors, GAMMA * right)

    if scanned:
        u = _looped(stage, y, push)
        after = y + jnp.asarray(_TABLES[0][-1], y.dtype) @ u + u[-1]
        return after, u[-1], jacobian
    stages: list[Array] = []
    for i, node in enumerate(AT):
        point = y + sum(a * item for a, item in zip(A[i], stages))
        before = sum(c * entry for c, entry in zip(C[i], stages))
        stages.append(stage(point, push.at[node], before, BY_TIME[i]))
    return y + sum(a * value for a, value in zip(A[-1], stages)) + stages[-1], stages[-1], jacobian


def _looped(stage: Callable, y: Float[Array, " m"], push: Push) -> Float[Array, "8 m"]:
    """All stages, one after the other in one loop."""
    a, c = (jnp.asarray(table, y.dtype) for table in _TABLES)
    by_time, number = jnp.asarray(BY_TIME, y.dtype), jnp.arange(len(AT))

    def one(u, now):
        i, a, c, by_time, drive = now
        return u.at[i].set(stage(y + a @ u, drive, c @ u, by_time)), None

    start = jnp.zeros((len(AT), len(y)), y.dtype)
    return jax.lax.scan(one, start, (number, a, c, by_time, push.at[np.array(AT)]))[0]
