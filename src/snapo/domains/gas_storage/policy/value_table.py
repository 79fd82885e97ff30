"""The baseline of the policy: the marginal value of gas from a dynamic program, with innovations.

With one price factor the baseline is a table of values; with several factors it is a fitted value
iteration. The policy adds a network to it. The baseline is data, not a function of the inputs: a
sensitivity changes the contract and the market, but not the baseline. The innovations of the fitted
value along a path are the control variate of the value of a store.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..bounds.basis import REACH, powers
from ..bounds.value_iteration import InnovationTable
from ..references.marginal import MarginalValues


class Knots(NamedTuple):
    """One day of the value table: evenly spaced inventories from `low` to `high`, with [rows, n]
    coefficients `above` and `below` each of them. The coefficients are valid for whitened factors
    up to `reach`."""

    low: Array
    high: Array
    above: Array
    below: Array
    reach: Array

    def values(self, process, terms, now, state, above, below) -> list[Array]:
        """The marginal values above and below these inventories at the end of the day.

        The slow factors scale all of them equally.
        """
        level = process.slow_level(terms.price, now.price, state)
        x = jnp.clip(process.fast(state), -self.reach, self.reach)
        result = readings(self, above, below, lambda row: jnp.polyval(row[::-1], x))
        return [level * item for item in result]


class ValueTable(eqx.Module):
    """A value table: `knots` has leaves with a leading axis of days, and a method `values`."""

    knots: Any

    @classmethod
    def of(cls, result: MarginalValues) -> "ValueTable":
        table = (result.low, result.high, result.above, result.below, result.reach)
        return cls(Knots(*table))  # pyright: ignore[reportArgumentType]


def readings(knots, above, below, value) -> list[Array]:
    """The function `value` of the rows of coefficients: from the side `above` at the inventories
    `above`, and from the side `below` at the inventories `below`."""
    upper = [between(knots, knots.above, inventory, value) for inventory in above]
    return upper + [between(knots, knots.below, inventory, value) for inventory in below]


def between(knots, rows, inventory, value):
    """The function `value` of a row of coefficients, linear between the rows on either side of an
    inventory."""
    segments = rows.shape[0] - 1
    # A day may leave no choice of inventory; every row then holds the same value.
    width = jnp.where(knots.high > knots.low, knots.high - knots.low, jnp.inf)
    position = (inventory - knots.low) / width * segments
    left = jnp.clip(jnp.floor(position), 0, segments - 1)
    # Inventories are exactly on the first and the last row. The line goes on beyond them, so that a
    # rounding does not decide about the slope there.
    share = position - left
    row = left.astype(jnp.int32)
    low, high = (value(rows[item]) for item in (row, row + 1))
    return low + share * (high - low)


class FittedKnots(NamedTuple):
    """One day of a `bounds.value_iteration.FittedMarginal`."""

    low: Array
    high: Array
    above: Array
    below: Array
    whiten: Array
    common: Array
    shift: Array
    exponents: Array | None = None
    exponents_ahead: Array | None = None

    def values(self, process, terms, now, state, above, below) -> list[Array]:
        """The marginal values above and below these inventories at the end of the day."""
        observed = functions(self, process.gaussian(state), self.above.shape[-1], REACH)
        return readings(self, above, below, lambda row: row @ observed)


def functions(reading, factors: Array, size: int, reach: float = math.inf) -> Array:
    """[size] the polynomials times the exponential, then the constant if there is one.

    `reading` has the `whiten`, `common`, `shift` and `exponents` of a day; whitened factors are cut
    at `reach`. If there are exponents, the last factor is the spike, and each function of the other
    factors is multiplied by the exponentials of the spike.
    """
    if reading.exponents is not None:
        inner = reading._replace(exponents=None)
        others = functions(inner, factors[:-1], size // len(reading.exponents), reach)
        return jnp.ravel(others[:, None] * jnp.exp(reading.exponents * factors[-1]))
    y = reading.whiten @ factors
    y = jnp.clip(y, -reach, reach) if math.isfinite(reach) else y
    level = jnp.exp(jnp.sum(reading.common * factors) - reading.shift)
    levels = [level * polynomial for polynomial in _polynomials(y)]
    if size > len(levels):
        levels.append(jnp.ones_like(level))
    return jnp.stack(levels)


def _polynomials(y: Array) -> list[Array]:
    """The products of normalised Hermite polynomials, in the order of `powers`."""
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


class DateValues(NamedTuple):
    """The value on one date: `bounds.value_iteration.InnovationTable`."""

    low: Array
    high: Array
    coefficients: Array


class Reading(NamedTuple):
    """The mapping from price factors to the functions of one date."""

    whiten: Array
    common: Array
    shift: Array
    exponents: Array | None = None
    exponents_ahead: Array | None = None

    def ahead(self, factors: Array, size: int, now: Array) -> Array:
        """The functions in which expectations of the next date are expressed; `now`: the functions
        of the day."""
        if self.exponents is None:
            return now
        return functions(self._replace(exponents=self.exponents_ahead), factors, size)


class SurpriseDay(NamedTuple):
    """One day: its value, the expectation of the value on the next date, and its functions."""

    now: DateValues
    ahead: DateValues
    reading: Reading


class SurpriseEnd(NamedTuple):
    """The end date, and the expectation on the valuation date."""

    now: DateValues
    reading: Reading
    first: Array


class Innovations(eqx.Module):
    """`days` has leaves with a leading axis of days."""

    days: Any
    end: Any

    @classmethod
    def of(cls, result: InnovationTable) -> "Innovations":
        position = DateValues(result.low, result.high, result.now)  # pyright: ignore
        reading = Reading(*result[-5:])  # pyright: ignore
        first = DateValues(*(item[:-1] for item in position))
        ahead = DateValues(result.low[1:], result.high[1:], result.ahead)  # pyright: ignore
        days = SurpriseDay(first, ahead, jax.tree.map(lambda x: x[:-1], reading))
        last = (
            DateValues(*(value[-1] for value in position)),
            jax.tree.map(lambda x: x[-1], reading),
        )
        return cls(days, SurpriseEnd(*last, np.asarray(result.first)))  # pyright: ignore


def of_day(row: SurpriseDay, factors: Array, before: Array, after: Array) -> Array:
    """The value at the start of a day minus its expectation for the next date.

    The sum of these differences over the days, plus the value on the end date minus `first`, is the
    sum of the innovations. `before` and `after` are the inventories at the start and the end of the
    day.
    """
    # Data without a derivative: an adjoint need not form any.
    row, factors, before, after = jax.lax.stop_gradient((row, factors, before, after))
    size = row.now.coefficients.shape[-1]
    observed = functions(row.reading, factors, size)
    ahead = row.reading.ahead(factors, size, observed)
    return _worth(row.now, before, observed) - _worth(row.ahead, after, ahead)


def of_end(row: SurpriseEnd, factors: Array, left: Array) -> Array:
    """The part of the sum on the end date."""
    row, factors, left = jax.lax.stop_gradient((row, factors, left))
    observed = functions(row.reading, factors, row.now.coefficients.shape[-1])
    return _worth(row.now, left, observed) - row.first


def _worth(position: DateValues, inventory: Array, observed: Array) -> Array:
    inside = jnp.clip(inventory, position.low, position.high)
    return between(position, position.coefficients, inside, lambda row: row @ observed)
