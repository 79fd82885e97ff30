"""The guide of several price factors: the marginal value of gas of a fitted value iteration."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..bounds.basis import REACH, powers
from .value_table import between


class FittedKnots(NamedTuple):
    """One day of `bounds.guide.FittedMarginal`: see there."""

    low: Array
    high: Array
    coefficients: Array
    whiten: Array
    common: Array
    shift: Array

    def values(self, process, terms, now, state, inventories) -> list[Array]:
        """Marginal values, as present values, at these inventories at the end of the day."""
        factors = process.gaussian(state)
        y = jnp.clip(self.whiten @ factors, -REACH, REACH)
        level = jnp.exp(jnp.sum(self.common * factors) - self.shift)
        functions = [level * each for each in _polynomials(y)]
        if self.coefficients.shape[-1] > len(functions):
            functions.append(jnp.ones_like(level))
        seen = jnp.stack(functions)
        return [between(self, inventory, lambda row: row @ seen) for inventory in inventories]


def _polynomials(y: Array) -> list[Array]:
    """Products of normalised Hermite polynomials, in the order of `powers`."""
    degrees = powers(y.shape[0])
    tables = []
    for i in range(y.shape[0]):
        table = [jnp.ones_like(y[i]), y[i]]
        for n in range(1, int(degrees.max())):
            table.append((y[i] * table[n] - math.sqrt(n) * table[n - 1]) / math.sqrt(n + 1))
        tables.append(table)
    found = []
    for row in degrees:
        factor = [tables[i][int(d)] for i, d in enumerate(row) if d]
        found.append(math.prod(factor[1:], start=factor[0]) if factor else jnp.ones_like(y[0]))
    return found
