"""The inventories from which a contract can be met, as one interval of each day.

The intervals are for policies, and differentiable. Backwards from the end, an inventory is feasible
if a feasible inventory can be reached from it by a flow. Between ratchet rows every condition is
linear in the inventory, so that the feasible inventories form an interval there. Neighbouring
intervals are joined, and the longest is selected. This interval is the complete set if I -
withdrawal(I) and I + injection(I) do not decrease and no flow is forced. Otherwise the set may have
several intervals; `feasibility` refuses a case that would need more than one.

JAX evaluates the formulas in a simulator, NumPy in a check of a case.
"""

from typing import Any, NamedTuple

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import backwards, running_maximum, xp

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
    end_low: Any,
    end_high: Any,
    interpolation: str,
) -> tuple[Float[Array, " T+1"], Float[Array, " T+1"]]:
    """The smallest and the largest inventory at the start of every day, and on the end date.

    If a day has no feasible continuation, the smallest is above the largest on this day and on all
    days before it.
    """
    tolerance = tolerance_of(limits)

    def back(successor, day):
        return _going_on(day, successor, interpolation, tolerance)

    low, high = backwards(back, (end_low, end_high), limits, len(limits.minimum))
    return xp.append(low, end_low), xp.append(high, end_high)


def tolerance_of(limits: InventoryLimits):
    """The round-off that is allowed at a limit that is met exactly."""
    return TOLERANCE * xp.max(xp.abs(limits.maximum), initial=1.0)


def _going_on(day: InventoryLimits, successor, interpolation: str, tolerance):
    """The longest interval of a day from which the interval of the next day can be reached."""
    return _longest(*segments(day, successor, interpolation, tolerance)[:4])


def segments(day: InventoryLimits, successor, interpolation: str, tolerance):
    """The inventories of a day from which the interval of the next day can be reached, between
    neighbouring ratchet rows.

    Five arrays, or pairs of arrays, by segment: `low`; `high`; whether the segment has such
    inventories; whether they begin and end with the segment; and whether the segment stops before a
    row from which the interval cannot be reached.
    """
    next_low, next_high = successor
    # A row at a limit is the limit: with clip each would take half of the derivative.
    inner = xp.where(day.levels <= day.minimum, day.minimum, day.levels)
    inner = xp.where(inner >= day.maximum, day.maximum, inner)
    left = xp.concatenate([day.minimum[None], inner])
    right = xp.concatenate([inner, day.maximum[None]])
    starts = _conditions(day, left, next_low, next_high, _rates(day, left, interpolation))
    endpoints = _conditions(day, right, next_low, next_high, _rates(day, right, interpolation))
    starts, endpoints = (xp.where(xp.abs(x) < tolerance, 0.0, x) for x in (starts, endpoints))
    crossing = xp.where(starts != endpoints, starts - endpoints, 1.0)
    zero = xp.clip(starts / crossing, 0.0, 1.0)  # where a condition changes sign, 0 to 1
    enter = xp.max(xp.where(starts >= 0, 0.0, xp.where(endpoints >= 0, zero, 2.0)), axis=0)
    leave = xp.min(xp.where(endpoints >= 0, 1.0, xp.where(starts >= 0, zero, -1.0)), axis=0)
    some = (enter <= leave) & (next_low <= next_high)
    low, high = left + enter * (right - left), left + leave * (right - left)
    touches, stops = (enter <= 0, leave >= 1), xp.zeros_like(some)
    if interpolation == "step":
        # Rows that hold nowhere within the limits do not count.
        following_row = xp.append(day.levels[1:], xp.inf)
        contains = (day.levels <= day.maximum) & (following_row > day.minimum)
        some = some & xp.concatenate([contains[:1], contains])
        # At a row its own rates apply: if these are infeasible, stop before it.
        goes_on = some[1:] & touches[0][1:]
        stops = touches[1][:-1] & ~goes_on & (day.levels <= day.maximum)
        spare = xp.where(high[:-1] - low[:-1] > tolerance, tolerance, 0.0)
        high = high - xp.append(xp.where(stops, spare, 0.0), 0.0)
        stops = xp.append(stops, False)
    return low, high, some, touches, stops


def _conditions(day: InventoryLimits, inventory, next_low, next_high, rates):
    """Four numbers [4, segments] that must not be negative for an inventory to be feasible."""
    withdrawal, injection = rates
    selected = inventory * (1 - day.inventory_loss)
    minimum = xp.where(day.min_injection > 0, day.min_injection, -withdrawal)
    maximum = xp.where(day.min_withdrawal > 0, -day.min_withdrawal, injection)
    return xp.stack(
        [
            next_high - selected - minimum,
            selected + maximum - next_low,
            injection - day.min_injection,
            withdrawal - day.min_withdrawal,
        ]
    )


def _rates(day: InventoryLimits, inventory, interpolation: str):
    """Withdrawal and injection at these inventories; with step ratchets, those of the piece."""
    if interpolation == "linear":
        return _between(inventory, day.levels, xp.stack([day.withdrawal_rate, day.injection_rate]))
    # Piece j lies between rows j - 1 and j; below the first row that row holds.
    rows = xp.maximum(xp.arange(inventory.shape[0]) - 1, 0)
    return day.withdrawal_rate[rows], day.injection_rate[rows]


def _between(inventory, levels, rates):
    """Rates [2, n] at inventories [n], linear between the rows and constant beyond them.

    The result is that of `interp` for each, with a third of the operations, so that `prepare`
    compiles faster.
    """
    if levels.shape[0] == 1:
        return xp.broadcast_to(rates, (2, inventory.shape[0]))
    row = xp.sum(levels[1:-1] <= inventory[:, None], axis=1)
    table = xp.concatenate([levels[None], rates])
    low, high = table[:, row], table[:, row + 1]
    width = high[0] - low[0]
    share = (inventory - low[0]) / xp.where(width > 0, width, 1.0)
    share = xp.where(inventory > levels[-1], 1.0, xp.where(inventory < levels[0], 0.0, share))
    return low[1:] + share * (high[1:] - low[1:])


def _longest(low, high, some, touches):
    """Joins neighbouring segments that touch, and selects the longest joined one."""
    enters, leaves = touches
    joined = xp.append(False, some[:-1] & some[1:] & leaves[:-1] & enters[1:])
    # A run begins at its last segment that is not joined to the one before.
    first = running_maximum(xp.where(joined, 0, xp.arange(low.shape[0])))
    start = low[first]
    selected = xp.argmax(xp.where(some, high - start, -1.0))
    result = xp.any(some)
    return (
        xp.where(result, start[selected], 1.0),
        xp.where(result, high[selected], -1.0),
    )
