"""The inventories from which a storage contract can still be met, day by day, differentiably.

Backwards from the end: an inventory can go on when some feasible flow leads to an inventory
that can. Between ratchet rows every condition is linear in the inventory, so those that can go on
are an interval there; neighbouring intervals are joined and the longest is kept. That is the whole
reachable set where I - withdrawal(I) and I + injection(I) do not decrease; where step ratchets
break that, it is the largest interval whose every point can go on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

TOLERANCE = 1e-9  # of the largest limit: rounding must not turn a contract met exactly into none


class InventoryLimits(NamedTuple):
    """Bounds of the inventory and of its change, per day: leaves [T] or [T, K]."""

    minimum: Float[Array, " T"]
    maximum: Float[Array, " T"]
    inventory_loss: Float[Array, " T"]
    levels: Float[Array, "T K"]
    withdrawal_rate: Float[Array, "T K"]
    injection_rate: Float[Array, "T K"]
    min_injection: Float[Array, " T"]
    min_withdrawal: Float[Array, " T"]


def reachable(
    limits: InventoryLimits,
    end_low: Float[Array, ""],
    end_high: Float[Array, ""],
    interpolation: str,
) -> tuple[Float[Array, " T+1"], Float[Array, " T+1"]]:
    """Least and greatest inventory at the start of every day, and on the end date.

    A day on which nothing can go on has least > greatest (and so have all days before it).
    """
    tolerance = TOLERANCE * jnp.max(jnp.abs(limits.maximum), initial=1.0)

    def back(successor, day):
        interval = _going_on(day, successor, interpolation, tolerance)
        return interval, interval

    _, (low, high) = jax.lax.scan(back, (end_low, end_high), limits, reverse=True)
    return jnp.append(low, end_low), jnp.append(high, end_high)


def _going_on(day: InventoryLimits, successor, interpolation: str, tolerance):
    """The longest interval of one day from which the one that follows can be reached."""
    next_low, next_high = successor
    # A row at a limit is the limit: with jnp.clip each would take half of the derivative.
    inner = jnp.where(day.levels <= day.minimum, day.minimum, day.levels)
    inner = jnp.where(inner >= day.maximum, day.maximum, inner)
    left = jnp.concatenate([day.minimum[None], inner])
    right = jnp.concatenate([inner, day.maximum[None]])
    starts = _conditions(day, left, next_low, next_high, _rates(day, left, interpolation))
    endpoints = _conditions(day, right, next_low, next_high, _rates(day, right, interpolation))
    starts, endpoints = (jnp.where(jnp.abs(x) < tolerance, 0.0, x) for x in (starts, endpoints))
    crossing = jnp.where(starts != endpoints, starts - endpoints, 1.0)
    zero = jnp.clip(starts / crossing, 0.0, 1.0)  # where a condition changes sign, 0 to 1
    enter = jnp.max(jnp.where(starts >= 0, 0.0, jnp.where(endpoints >= 0, zero, 2.0)), axis=0)
    leave = jnp.min(jnp.where(endpoints >= 0, 1.0, jnp.where(starts >= 0, zero, -1.0)), axis=0)
    some = (enter <= leave) & (next_low <= next_high)
    low, high = left + enter * (right - left), left + leave * (right - left)
    touches = enter <= 0, leave >= 1
    if interpolation == "step":
        # Rows that hold nowhere within the limits do not count.
        following_row = jnp.append(day.levels[1:], jnp.inf)
        contains = (day.levels <= day.maximum) & (following_row > day.minimum)
        some = some & jnp.concatenate([contains[:1], contains])
        # At a row its own rates hold: where those cannot go on, stop short of it.
        goes_on = some[1:] & touches[0][1:]
        stops = touches[1][:-1] & ~goes_on & (day.levels <= day.maximum)
        spare = jnp.where(high[:-1] - low[:-1] > tolerance, tolerance, 0.0)
        high = high.at[:-1].add(-jnp.where(stops, spare, 0.0))
    return _longest(low, high, some, touches)


def _conditions(day: InventoryLimits, inventory, next_low, next_high, rates):
    """Four numbers [4, pieces] that must not be negative for an inventory to go on."""
    withdrawal, injection = rates
    selected = inventory * (1 - day.inventory_loss)
    minimum = jnp.where(day.min_injection > 0, day.min_injection, -withdrawal)
    maximum = jnp.where(day.min_withdrawal > 0, -day.min_withdrawal, injection)
    return jnp.stack(
        [
            next_high - selected - minimum,
            selected + maximum - next_low,
            injection - day.min_injection,
            withdrawal - day.min_withdrawal,
        ]
    )


def _rates(day: InventoryLimits, inventory, interpolation: str):
    """Withdrawal and injection at these inventories; step rates are those of the piece."""
    if interpolation == "linear":
        return _between(inventory, day.levels, jnp.stack([day.withdrawal_rate, day.injection_rate]))
    # Piece j lies between rows j - 1 and j; below the first row that row holds.
    rows = jnp.maximum(jnp.arange(inventory.shape[0]) - 1, 0)
    return day.withdrawal_rate[rows], day.injection_rate[rows]


def _between(inventory, levels, rates):
    """Rates [2, n] at inventories [n], linear between the rows and constant beyond them.

    As `jnp.interp` of each, in a third of the operations: `prepare` is soon compiled.
    """
    if levels.shape[0] == 1:
        return jnp.broadcast_to(rates, (2, inventory.shape[0]))
    row = jnp.sum(levels[1:-1] <= inventory[:, None], axis=1)
    table = jnp.concatenate([levels[None], rates])
    low, high = table[:, row], table[:, row + 1]
    width = high[0] - low[0]
    share = (inventory - low[0]) / jnp.where(width > 0, width, 1.0)
    share = jnp.where(inventory > levels[-1], 1.0, jnp.where(inventory < levels[0], 0.0, share))
    return low[1:] + share * (high[1:] - low[1:])


def _longest(low, high, some, touches):
    """Joins neighbouring pieces that touch, and keeps the longest run."""
    enters, leaves = touches
    joined = jnp.append(False, some[:-1] & some[1:] & leaves[:-1] & enters[1:])
    # A run begins at its last piece that is not joined to the one before.
    first = jax.lax.cummax(jnp.where(joined, 0, jnp.arange(low.shape[0])))
    start = low[first]
    selected = jnp.argmax(jnp.where(some, high - start, -1.0))
    result = jnp.any(some)
    return (
        jnp.where(result, start[selected], 1.0),
        jnp.where(result, high[selected], -1.0),
    )
