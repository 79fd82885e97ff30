"""Small linear systems by elimination, written so that both engines take it.

The inverse by Gauss and Jordan with partial pivoting: m rounds on whole rows, the pivot's row
taken and put by selection, so that nothing but arithmetic is left. One step of iterative refinement
brings the solution to the accuracy of a factorisation (Higham, Accuracy and Stability of Numerical
Algorithms, section 12.1).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

WRITTEN_OUT = 24  # unknowns above which LAPACK factorises, which the native engine does not have


class Factors(NamedTuple):
    """A matrix [m, m], ready to be solved with: its inverse, or LAPACK's factors and pivots."""

    table: Float[Array, "m m"]
    pivots: Array | None


def factorised(matrix: Float[Array, "m m"]) -> Factors:
    """The factors of a matrix, without derivatives: `solve` has them."""
    matrix = jax.lax.stop_gradient(matrix)
    if len(matrix) <= WRITTEN_OUT:
        return Factors(_inverse(matrix), None)
    return Factors(*jax.scipy.linalg.lu_factor(matrix))


@jax.custom_jvp
def solve(
    matrix: Float[Array, "m m"], factors: Factors, right: Float[Array, " m"]
) -> Float[Array, " m"]:
    """x with `matrix` x = `right`; its derivatives are those of the exact solution."""
    first = _apply(factors, right)
    return first + _apply(factors, right - matrix @ first)


@solve.defjvp
def _solve_tangent(primals, tangents):
    matrix, factors, right = primals
    d_matrix, _, d_right = tangents
    found = solve(matrix, factors, right)
    return found, solve(matrix, factors, d_right - d_matrix @ found)


def _apply(factors: Factors, right: Array) -> Array:
    if factors.pivots is None:
        return factors.table @ right
    return jax.scipy.linalg.lu_solve((factors.table, factors.pivots), right)


def _inverse(matrix: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """The inverse; not finite where the matrix is singular."""
    size = len(matrix)
    table = jnp.concatenate([matrix, jnp.eye(size, dtype=matrix.dtype)], 1)
    for k in range(size):
        below = jnp.abs(table[:, k]) * (jnp.arange(size) >= k)
        chosen = (jnp.arange(size) == jnp.argmax(below))[:, None]
        pivot = jnp.sum(jnp.where(chosen, table, 0.0), 0)
        table = jnp.where(chosen, table[k], table)
        pivot = pivot / pivot[k]
        here = (jnp.arange(size) == k)[:, None]
        table = jnp.where(here, pivot, table - table[:, k, None] * pivot)
    return table[:, size:]
