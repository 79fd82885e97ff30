"""What theory knows before training: the marginal value of gas of a one-factor dynamic program.

The policy is a network on top of this table. It is data, not a function of the inputs: an input's
sensitivity moves the contract and the market, not the guide.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .marginal import MarginalValues


class Knots(NamedTuple):
    """One day of the guide: uniform inventories from `low` to `high`, [levels, 3] coefficients in
    the fast factor's state, to be trusted up to `reach` on either side."""

    low: Array
    high: Array
    reach: Array
    coefficients: Array


class Guide(eqx.Module):
    """The table of `marginal.MarginalValues`, leaves with a leading axis of days."""

    knots: Knots

    @classmethod
    def of(cls, found: MarginalValues) -> "Guide":
        table = (found.low, found.high, found.reach, found.coefficients)
        return cls(Knots(*table))  # pyright: ignore[reportArgumentType]


def marginal_value(knots: Knots, inventory, x):
    """The guide's marginal value at an inventory and a fast factor's state."""
    c, x = knots.coefficients, jnp.clip(x, -knots.reach, knots.reach)
    values = c[:, 0] + x * (c[:, 1] + x * c[:, 2])
    # A day may leave no choice of inventory; every level then holds the same value.
    width = jnp.where(knots.high > knots.low, knots.high - knots.low, jnp.inf)
    pieces = values.shape[0] - 1
    place = (inventory - knots.low) / width * pieces - jnp.arange(pieces)
    # Line by line instead of an index: no gather per path. Stores stand exactly on the first and
    # the last knot, so ties must leave one side's slope: `jnp.clip` would halve it.
    share = jnp.where(place < 0, 0.0, jnp.where(place < 1, place, 1.0))
    return values[0] + jnp.sum(share * jnp.diff(values))
