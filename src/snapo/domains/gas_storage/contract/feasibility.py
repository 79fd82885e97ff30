"""Whether the limits of a contract can be met: the inventories that can be in store, day by day, as
exact sets.

The inventories that can be in store at the start of a day form a few intervals. Since the rates are
linear (or constant) between ratchet rows, the set of the next day is computed exactly. The first
day with an empty set has the first constraint that no decision can meet.

Backwards from the end date, the inventories from which the contract can be met form a few intervals
too. Policies use one interval a day, see `reachable`. A case is refused if another one of
these intervals can be reached.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.problem.record.either import with_numpy

from .reachable import InventoryLimits, reachable, segments, tolerance_of
from .records import StorageCase
from .terms import end_interval, inventory_limits

FlowInterval = tuple[float, float]
FEW = 0.02  # of the largest inventory; narrower intervals may stay unused


@dataclass(frozen=True)
class FeasibleDay:
    """One day of the contract: its ratchet rows (with outages applied), forced flows and loss."""

    levels: list[float]
    withdrawal: list[float]
    injection: list[float]
    linear: bool
    min_withdrawal: float
    min_injection: float
    loss: float

    def rates(self, level: float, row: int | None = None) -> tuple[float, float]:
        """The largest withdrawal and injection at an inventory, or those of a row of step
        ratchets."""
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
    """An inventory at the start of the day, and the maximum withdrawal and injection at this
    inventory."""

    level: float
    withdrawal: float
    injection: float


def check_feasible(case: StorageCase) -> str:
    """Raises `CaseError` with the first date on which no decisions can keep a constraint, and this
    constraint. The result is a note on the case, or ""."""
    forced = case.contract.min_injection.used(), case.contract.min_withdrawal.used()
    for t in np.flatnonzero((forced[0] > 0) & (forced[1] > 0))[:1]:
        message = (
            f"on {case.days[t]} an injection of {forced[0][t]:g} and a withdrawal of "
            f"{forced[1][t]:g} are both forced, but a day can have only one of them"
        )
        raise _error(case, "min_injection", float(forced[0][t]), message)
    return _check_whole(case, attainable(case))


def attainable(case: StorageCase) -> list[list[FlowInterval]]:
    """The inventories that can be in store at the start of each day and on the end date, [T + 1].

    They are computed forwards from the initial inventory; the rule for the end date applies only to
    the last set.

    **Raises:** `CaseError` if there are none.
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
    """The round-off that is allowed at a limit that is met exactly."""
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
    """The inventories at the end of the day that can be reached from `interval`."""
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
    """The part of a piece in which the rates allow the forced flow of the day; None if there is
    none."""
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


@with_numpy
def _check_whole(case: StorageCase, attained: list[list[FlowInterval]]) -> str:
    """Refuses a case if inventories that can be in store, and from which the contract can be met,
    are outside the interval that policies use. If they are few, the result is a note; otherwise it
    is ""."""
    contract, kind = case.contract, case.contract.ratchets.interpolation
    limits, end = inventory_limits(contract, CaseInput.used), end_interval(contract, CaseInput.used)
    if not _may_split(limits, kind):
        return ""
    used, sets = reachable(limits, *end, kind), feasible_sets(limits, *end, kind)
    margin, few = 1e3 * slack(case), FEW * float(np.max(limits.maximum))
    unused: list[tuple[float, int, FlowInterval]] = []
    for t in reversed(range(len(sets))):
        low, high = float(used[0][t]), float(used[1][t])
        for first, last in sets[t]:
            both = [(max(x, first), min(y, last)) for x, y in attained[t]]
            both = [(x, y) for x, y in both if x <= y]
            if all(low - margin <= x and y <= high + margin for x, y in both):
                continue
            below = both[0][0] < low - margin
            other = (first, min(last, low)) if below else (max(first, high), last)
            if other[1] - other[0] > few or t == 0:  # policies could not even begin
                raise _split(case, t, sorted({other, (low, high) if low <= high else other}))
            unused.append((other[1] - other[0], t, other))
    if not unused:
        return ""
    _, t, widest = max(unused)
    return (
        f"contract.ratchets: on {_date(case, t)} the contract can be met with "
        f"{_words([widest], 6)} in store, but policies do not use these inventories, because they "
        "use only one range of inventories on each day."
    )


def _may_split(limits: InventoryLimits, interpolation: str) -> bool:
    """Whether the inventories from which the contract can be met may be several intervals."""
    if limits.levels.shape[1] == 1:
        return False
    if interpolation == "step" or (limits.min_injection + limits.min_withdrawal > 0).any():
        return True
    keep = limits.levels * (1 - limits.inventory_loss[:, None])
    reached = keep - limits.withdrawal_rate, keep + limits.injection_rate
    return any((np.diff(end, axis=1) < 0).any() for end in reached)


@with_numpy
def feasible_sets(
    limits: InventoryLimits, end_low: float, end_high: float, interpolation: str
) -> list[list[FlowInterval]]:
    """The inventories at the start of each day and on the end date, [T + 1], from which the
    contract can be met."""
    tolerance = float(tolerance_of(limits))
    sets = [[(float(end_low), float(end_high))]]
    for t in reversed(range(len(limits.minimum))):
        day = InventoryLimits(*(leaf[t] for leaf in limits))
        parts: list[FlowInterval] = []
        for interval in sets[-1]:
            low, high, some, _, stops = segments(day, interval, interpolation, tolerance)
            some = some & ~(stops & (high - low <= tolerance))
            high = high - 2 * tolerance * stops  # so that no other inventory reaches it by rounding
            parts += zip(low[some].tolist(), high[some].tolist())
        sets.append(_merge(parts, 4 * tolerance))
    return sets[::-1]


def _split(case: StorageCase, t: int, intervals: list[FlowInterval]) -> CaseError:
    message = (
        f"on {_date(case, t)} the contract can be met with {_words(intervals, 6)} in store, but "
        "the methods can use only one of these ranges, because then or later it cannot be met with "
        "inventories in between; let the rates differ less from row to row"
    )
    if case.contract.ratchets.interpolation == "step":
        message += ', or set ratchet_interpolation = "linear"'
    return CaseError(str(case.file), "contract.ratchets", None, message)


def _merge(intervals: list[FlowInterval], gap: float = 0.0) -> list[FlowInterval]:
    merged: list[FlowInterval] = []
    for low, high in sorted(intervals):
        if merged and low <= merged[-1][1] + gap:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


def _words(intervals: list[FlowInterval], digits: int = 10) -> str:
    numbers = [(f"{low:.{digits}g}", f"{high:.{digits}g}") for low, high in intervals]
    return " or ".join(low if low == high else f"{low} to {high}" for low, high in numbers)


def _date(case: StorageCase, t: int):
    return case.days[t] if t < len(case.days) else case.end


def _start(case: StorageCase) -> list[FlowInterval]:
    inventory = float(case.contract.inventory.used())
    low = float(case.contract.min_inventory.used()[0])
    high = float(case.contract.max_inventory.used()[0])
    if not low - slack(case) <= inventory <= high + slack(case):
        message = f"on {_date(case, 0)} the limits allow {low:.10g} to {high:.10g}"
        raise _error(case, "inventory", inventory, message)
    inventory = min(max(inventory, low), high)
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
    message = (
        f"with min_inventory {low:g} this cannot be met on {date}: the gas in store will be {text}"
    )
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
        message = f"this cannot be reached on {case.end}: the gas in store will be {_words(last)}"
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
