"""The guide of the policy: the marginal value of gas of a one-factor dynamic program, as a table.

The policy is a network on top of this table. It is data, not a function of the inputs: an input's
sensitivity moves the contract and the market, not the guide.
"""

from typing import NamedTuple

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


class ValueTable(eqx.Module):
    """The table of `marginal.MarginalValues`, leaves with a leading axis of days."""

    knots: Knots

    @classmethod
    def of(cls, found: MarginalValues) -> "ValueTable":
        table = (found.low, found.high, found.reach, found.coefficients)
        return cls(Knots(*table))  # pyright: ignore[reportArgumentType]


def marginal_value(knots: Knots, inventory, x):
    """The guide's marginal value at an inventory and a fast factor's state."""
    pieces = knots.coefficients.shape[0] - 1
    # A day may leave no choice of inventory; every level then holds the same value.
    width = jnp.where(knots.high > knots.low, knots.high - knots.low, jnp.inf)
    place = (inventory - knots.low) / width * pieces
    left = jnp.clip(jnp.floor(place), 0, pieces - 1)
    # Stores stand exactly on the first and the last knot. The line goes on beyond them, so that a
    # rounding does not decide about the slope there.
    share = place - left
    row = left.astype(jnp.int32)
    ends = knots.coefficients[row], knots.coefficients[row + 1]
    x = jnp.clip(x, -knots.reach, knots.reach)
    low, high = (c[0] + x * (c[1] + x * c[2]) for c in ends)
    return low + share * (high - low)
