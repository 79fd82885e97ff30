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
    """One day of the guide: uniform inventories from `low` to `high`, [levels, 3] coefficients in
    the fast factor's state, to be trusted up to `reach` on either side."""

    low: Array
    high: Array
    reach: Array
    coefficients: Array

    def values(self, process, terms, now, state, inventories) -> list[Array]:
        """Marginal values, as present values, at these inventories at the end of the day.

        The slow factors scale them all alike.
        """
        level = process.slow_level(terms.price, now.price, state)
        x = process.fast(state)
        return [marginal_value(self, inventory, x) * level for inventory in inventories]


class ValueTable(eqx.Module):
    """A guide: `knots` has leaves with a leading axis of days, and a method `values`."""

    knots: Any

    @classmethod
    def of(cls, found: MarginalValues) -> "ValueTable":
        table = (found.low, found.high, found.reach, found.coefficients)
        return cls(Knots(*table))  # pyright: ignore[reportArgumentType]


def marginal_value(knots: Knots, inventory, x):
    """The guide's marginal value at an inventory and a fast factor's state."""
    x = jnp.clip(x, -knots.reach, knots.reach)
    return between(knots, inventory, lambda c: c[0] + x * (c[1] + x * c[2]))


def between(knots, inventory, value):
    """`value` of a row of coefficients, linear between the rows on either side of an inventory."""
    pieces = knots.coefficients.shape[0] - 1
    # A day may leave no choice of inventory; every level then holds the same value.
    width = jnp.where(knots.high > knots.low, knots.high - knots.low, jnp.inf)
    place = (inventory - knots.low) / width * pieces
    left = jnp.clip(jnp.floor(place), 0, pieces - 1)
    # Stores stand exactly on the first and the last knot. The line goes on beyond them, so that a
    # rounding does not decide about the slope there.
    share = place - left
    row = left.astype(jnp.int32)
    low, high = (value(knots.coefficients[each]) for each in (row, row + 1))
    return low + share * (high - low)
