"""The guide of several price factors: the marginal value of gas of a fitted value iteration."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..bounds.basis import REACH, powers
from .value_table import readings


class FittedKnots(NamedTuple):
    """One day of `bounds.guide.FittedMarginal`: see there."""

    low: Array
    high: Array
    above: Array
    below: Array
    whiten: Array
    common: Array
    shift: Array

    def values(self, process, terms, now, state, above, below) -> list[Array]:
        """Marginal values, as present values, above and below these inventories at day's end."""
        observed = functions(self, process.gaussian(state), self.above.shape[-1], REACH)
        return readings(self, above, below, lambda row: row @ observed)


def functions(reading, factors: Array, size: int, reach: float = math.inf) -> Array:
    """[size] the polynomials times the exponential, then the constant where there is one.

    `reading` has a day's `whiten`, `common` and `shift`; whitened factors are cut at `reach`.
    """
    y = reading.whiten @ factors
    y = jnp.clip(y, -reach, reach) if math.isfinite(reach) else y
    level = jnp.exp(jnp.sum(reading.common * factors) - reading.shift)
    levels = [level * polynomial for polynomial in _polynomials(y)]
    if size > len(levels):
        levels.append(jnp.ones_like(level))
    return jnp.stack(levels)


def _polynomials(y: Array) -> list[Array]:
    """Products of normalised Hermite polynomials, in the order of `powers`."""
    degrees = powers(y.shape[0])
    tables = []
    for i in range(y.shape[0]):
        table = [jnp.ones_like(y[i]), y[i]]
        for n in range(1, int(degrees.max())):
            table.append((y[i] * table[n] - math.sqrt(n) * table[n - 1]) / math.sqrt(n + 1))
        tables.append(table)
    polynomials = []
    for row in degrees:
        factor = [tables[i][int(d)] for i, d in enumerate(row) if d]
        polynomials.append(
            math.prod(factor[1:], start=factor[0]) if factor else jnp.ones_like(y[0])
        )
    return polynomials
