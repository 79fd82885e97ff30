"""The inventories from which a contract can be met, day by day: exact sets, and one interval.

The set of inventories that can be in store at the start of a day is a few intervals; the rates are
linear (or constant) between ratchet rows, so the set of the next day follows exactly. When it is
empty, that day has the first constraint that no decision can meet.

For policies, and differentiable: backwards from the end, an inventory is feasible when some flow
reaches a feasible one. Between ratchet rows every condition is linear in the inventory, so the
feasible ones are an interval there; neighbouring intervals are joined and the longest is selected.
That is the complete reachable set where I - withdrawal(I) and I + injection(I) do not decrease;
where step ratchets break that, it is the largest interval in which every point is feasible.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.case.error import CaseError

from .records import StorageCase

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

    A day without a feasible continuation has least > greatest (and so have all days before it).
    """
    tolerance = TOLERANCE * jnp.max(jnp.abs(limits.maximum), initial=1.0)

    def back(successor, day):
        interval = _going_on(day, successor, interpolation, tolerance)
        return interval, interval

    _, (low, high) = jax.lax.scan(back, (end_low, end_high), limits, reverse=True)
    return jnp.append(low, end_low), jnp.append(high, end_high)


def _going_on(day: InventoryLimits, successor, interpolation: str, tolerance):
    """The longest interval of one day from which that of the next day can be reached."""
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
        # At a row its own rates apply: if these are infeasible, stop before it.
        goes_on = some[1:] & touches[0][1:]
        stops = touches[1][:-1] & ~goes_on & (day.levels <= day.maximum)
        spare = jnp.where(high[:-1] - low[:-1] > tolerance, tolerance, 0.0)
        high = high.at[:-1].add(-jnp.where(stops, spare, 0.0))
    return _longest(low, high, some, touches)


def _conditions(day: InventoryLimits, inventory, next_low, next_high, rates):
    """Four numbers [4, pieces] that must not be negative for an inventory to be feasible."""
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


FlowInterval = tuple[float, float]


@dataclass(frozen=True)
class FeasibleDay:
    """One day of the contract: ratchet rows (outages applied), forced flows, and loss."""

    levels: list[float]
    withdrawal: list[float]
    injection: list[float]
    linear: bool
    min_withdrawal: float
    min_injection: float
    loss: float

    def rates(self, level: float, row: int | None = None) -> tuple[float, float]:
        """Most withdrawal and injection at an inventory, or those of a row of step ratchets."""
        if row is None:
            row = max(bisect_right(self.levels, level) - 1, 0)
        if not self.linear or row == len(self.levels) - 1:
            return self.withdrawal[row], self.injection[row]
        width = self.levels[row + 1] - self.levels[row]
        share = (level - self.levels[row]) / width
        return (
            self.withdrawal[row] + share * (self.withdrawal[row + 1] - self.withdrawal[row]),
            self.injection[row] + share * (self.injection[row + 1] - self.injection[row]),
        )


@dataclass(frozen=True)
class Corner:
    """An inventory at the start of the day, and the maximum withdrawal and injection there."""

    level: float
    withdrawal: float
    injection: float


def check_feasible(case: StorageCase) -> None:
    """Raises `CaseError` with the first date and constraint that no decisions can keep."""
    forced = case.contract.min_injection.used(), case.contract.min_withdrawal.used()
    for t in np.flatnonzero((forced[0] > 0) & (forced[1] > 0))[:1]:
        message = (
            f"on {case.days[t]} an injection of {forced[0][t]:g} and a withdrawal of "
            f"{forced[1][t]:g} are both forced, and a day has one or the other"
        )
        raise _error(case, "min_injection", float(forced[0][t]), message)
    attainable(case)


def attainable(case: StorageCase) -> list[list[FlowInterval]]:
    """The inventories that can be in store at the start of each day and on the end date, [T + 1].

    Seen forward from the inventory given; the demand of the end is applied to the last only.
    **Raises:** `CaseError` where there are none.
    """
    sets = [_start(case)]
    tolerance = slack(case)
    for t, day in enumerate(read_days(case)):
        moved = [move for interval in sets[-1] for move in _moves(day, interval, tolerance)]
        if not moved:
            raise _forced_flow(case, t, day, sets[-1])
        sets.append(_within_limits(case, t + 1, _merge(moved), tolerance))
    owed = case.contract.at_end.owed
    if owed is not None:
        _check_level(case, owed, sets[-1], tolerance)
    return sets


def slack(case: StorageCase) -> float:
    """The volume that rounding may take from a limit that is met exactly."""
    return 1e-9 * max(1.0, float(case.contract.max_inventory.used().max()))


def read_days(case: StorageCase) -> Iterator[FeasibleDay]:
    """The contract day by day, as plain numbers."""
    contract = case.contract
    ratchets = contract.ratchets
    levels = ratchets.inventory.used()
    withdrawal = ratchets.withdrawal.used() * contract.withdrawal_factor[:, None]
    injection = ratchets.injection.used() * contract.injection_factor[:, None]
    min_withdrawal = contract.min_withdrawal.used()
    min_injection = contract.min_injection.used()
    loss = contract.inventory_loss.used()
    for t in range(len(case.days)):
        yield FeasibleDay(
            levels[t].tolist(),
            withdrawal[t].tolist(),
            injection[t].tolist(),
            ratchets.interpolation == "linear",
            float(min_withdrawal[t]),
            float(min_injection[t]),
            float(loss[t]),
        )


def _pieces(day: FeasibleDay, interval: FlowInterval) -> Iterator[tuple[Corner, Corner]]:
    """Cuts an interval at the ratchet rows: on each piece the rates are linear."""
    low, high = interval
    cuts = [low, *(level for level in day.levels if low < level < high), high]
    for left, right in pairwise(cuts):
        row = None if day.linear else max(bisect_right(day.levels, left) - 1, 0)
        yield Corner(left, *day.rates(left, row)), Corner(right, *day.rates(right, row))
    if not day.linear:
        # At a row of step ratchets its own rates hold, not those of the piece below.
        corner = Corner(high, *day.rates(high))
        yield corner, corner


def _moves(day: FeasibleDay, interval: FlowInterval, tolerance: float) -> Iterator[FlowInterval]:
    """Where the inventory can be at the end of the day, from anywhere in `interval`."""
    for piece in _pieces(day, interval):
        selected = _able(day, piece, tolerance)
        if selected is None:
            continue
        endpoints = []
        for corner in selected:
            keep = corner.level * (1 - day.loss)
            # Rates that fall short of a forced flow by rounding do not turn the interval round.
            lowest = -max(corner.withdrawal, day.min_withdrawal)
            highest = max(corner.injection, day.min_injection)
            if day.min_injection > 0:
                lowest = day.min_injection
            if day.min_withdrawal > 0:
                highest = -day.min_withdrawal
            endpoints.append((keep + lowest, keep + highest))
        yield min(end[0] for end in endpoints), max(end[1] for end in endpoints)


def _able(day: FeasibleDay, piece: tuple[Corner, Corner], tolerance: float):
    """The part of a piece whose rates allow the day's forced flow; None where none does."""
    left, right = piece
    if day.min_injection > 0:
        spare = [corner.injection - day.min_injection + tolerance for corner in piece]
    else:
        spare = [corner.withdrawal - day.min_withdrawal + tolerance for corner in piece]
    if min(spare) >= 0:
        return piece
    if max(spare) < 0:
        return None
    share = spare[0] / (spare[0] - spare[1])
    middle = Corner(
        left.level + share * (right.level - left.level),
        left.withdrawal + share * (right.withdrawal - left.withdrawal),
        left.injection + share * (right.injection - left.injection),
    )
    return (left, middle) if spare[0] >= 0 else (middle, right)


def _merge(intervals: list[FlowInterval]) -> list[FlowInterval]:
    merged: list[FlowInterval] = []
    for low, high in sorted(intervals):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


def _words(intervals: list[FlowInterval]) -> str:
    return " or ".join(
        f"{low:.10g} to {high:.10g}" if low < high else f"{low:.10g}" for low, high in intervals
    )


def _date(case: StorageCase, t: int):
    return case.days[t] if t < len(case.days) else case.end


def _start(case: StorageCase) -> list[FlowInterval]:
    inventory = float(case.contract.inventory.used())
    low = float(case.contract.min_inventory.used()[0])
    high = float(case.contract.max_inventory.used()[0])
    if not low <= inventory <= high:
        message = f"on {_date(case, 0)} the limits allow {low:g} to {high:g}"
        raise _error(case, "inventory", inventory, message)
    return [(inventory, inventory)]


def _within_limits(case: StorageCase, t: int, flows: list[FlowInterval], tolerance: float):
    low = float(case.contract.min_inventory.used()[t])
    high = float(case.contract.max_inventory.used()[t])
    selected = [
        (min(max(left, low), high), max(min(right, high), low))
        for left, right in flows
        if right >= low - tolerance and left <= high + tolerance
    ]
    if selected:
        return selected
    maximum, minimum, date = flows[-1][1], flows[0][0], _date(case, t)
    if maximum < low:
        message = f"this cannot be met on {date}: by then at most {maximum:.10g} can be in store"
        raise _error(case, "min_inventory", low, message)
    if minimum > high:
        message = f"this cannot be met on {date}: by then at least {minimum:.10g} is in store"
        raise _error(case, "max_inventory", high, message)
    text = _words(flows)
    message = f"with min_inventory {low:g} this cannot be met on {date}: in store will be {text}"
    raise _error(case, "max_inventory", high, message)


def _check_level(
    case: StorageCase, level: float, last: list[FlowInterval], tolerance: float
) -> None:
    if any(low - tolerance <= level <= high + tolerance for low, high in last):
        return
    limits = case.contract.min_inventory.used()[-1], case.contract.max_inventory.used()[-1]
    if not limits[0] <= level <= limits[1]:
        message = f"on {case.end} the limits allow {limits[0]:g} to {limits[1]:g}"
    else:
        message = f"this cannot be reached on {case.end}: in store will be {_words(last)}"
    raise _error(case, "end_inventory", level, message)


def _forced_flow(
    case: StorageCase, t: int, day: FeasibleDay, before: list[FlowInterval]
) -> CaseError:
    injecting = day.min_injection > 0
    corners = [c for interval in before for piece in _pieces(day, interval) for c in piece]
    maximum = max(corner.injection if injecting else corner.withdrawal for corner in corners)
    factors = case.contract.injection_factor if injecting else case.contract.withdrawal_factor
    cause = f" in the outage (factor {factors[t]:g})" if factors[t] < 1 else ""
    message = (
        f"this cannot be met on {case.days[t]}: at most {maximum:.10g} is possible then{cause}"
    )
    if injecting:
        return _error(case, "min_injection", day.min_injection, message)
    return _error(case, "min_withdrawal", day.min_withdrawal, message)


def _error(case: StorageCase, key: str, value: float, allowed: str) -> CaseError:
    return CaseError(str(case.file), f"contract.{key}", value, allowed)
