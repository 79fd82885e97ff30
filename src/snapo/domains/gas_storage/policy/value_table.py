"""The guide of the policy: the marginal value of gas of a one-factor dynamic program, as a table.

The policy is a network on top of this table. It is data, not a function of the inputs: an input's
sensitivity moves the contract and the market, not the guide.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from ..references.marginal import MarginalValues


class Knots(NamedTuple):
    """One day of the guide: uniform inventories from `low` to `high`, with [rows, n] coefficients
    in the fast factor's state `above` and `below` them, to be trusted up to `reach`."""

    low: Array
    high: Array
    above: Array
    below: Array
    reach: Array

    def values(self, process, terms, now, state, above, below) -> list[Array]:
        """Marginal values, as present values, above and below these inventories at day's end.

        The slow factors scale them all alike.
        """
        level = process.slow_level(terms.price, now.price, state)
        x = jnp.clip(process.fast(state), -self.reach, self.reach)
        result = readings(self, above, below, lambda row: jnp.polyval(row[::-1], x))
        return [level * item for item in result]


class ValueTable(eqx.Module):
    """A guide: `knots` has leaves with a leading axis of days, and a method `values`."""

    knots: Any

    @classmethod
    def of(cls, result: MarginalValues) -> "ValueTable":
        table = (result.low, result.high, result.above, result.below, result.reach)
        return cls(Knots(*table))  # pyright: ignore[reportArgumentType]


def readings(knots, above, below, value) -> list[Array]:
    """`value` of a row of coefficients, above the inventories `above` and below those `below`."""
    upper = [between(knots, knots.above, inventory, value) for inventory in above]
    return upper + [between(knots, knots.below, inventory, value) for inventory in below]


def between(knots, rows, inventory, value):
    """`value` of a row of coefficients, linear between the rows on either side of an inventory."""
    segments = rows.shape[0] - 1
    # A day may leave no choice of inventory; every row then holds the same value.
    width = jnp.where(knots.high > knots.low, knots.high - knots.low, jnp.inf)
    position = (inventory - knots.low) / width * segments
    left = jnp.clip(jnp.floor(position), 0, segments - 1)
    # Stores stand exactly on the first and the last row. The line goes on beyond them, so that a
    # rounding does not decide about the slope there.
    share = position - left
    row = left.astype(jnp.int32)
    low, high = (value(rows[item]) for item in (row, row + 1))
    return low + share * (high - low)
