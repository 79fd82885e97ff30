"""Dynamic programming with exact piecewise-linear value functions, for prices known in advance.

Between breakpoints the value of inventory, the rate limits and the cash of a move are linear. The
maximum of one day is therefore the upper envelope of a few lines on each interval, without a grid
or an interpolation error, for ratchets of any shape.
"""

from typing import NamedTuple

import numpy as np

from .day_terms import (
    DayRates,
    Interpolation,
    UnitPrices,
    holding_cost,
    moves,
    rates,
    volume_scale,
)

# A breakpoint goes when that moves the value by less than this fraction of the largest value.
COLLINEAR = 1e-12
# Breakpoints nearer than this fraction of the largest inventory are one.
SAME = 1e-13


class PiecewiseLine(NamedTuple):
    """A continuous piecewise-linear function: its rising breakpoints, and its values at them.
    [n]"""

    at: np.ndarray
    value: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.interp(points, self.at, self.value)


def day_value(
    schedule,
    interpolation: Interpolation,
    t: int,
    prices: UnitPrices,
    after: PiecewiseLine,
    low: float,
    high: float,
) -> PiecewiseLine:
    """The value at the start of day t of every inventory in [low, high], computed from `after`, the
    value at its end. `prices` are the two unit prices of the day; `after` covers all inventories
    that can be reached from [low, high].
    """
    day_rates = rates(schedule, interpolation, t)
    scale = volume_scale(schedule)
    points = _breakpoints(schedule, day_rates, t, after.at, low, high, scale)
    today = moves(schedule, day_rates, t, points)
    lines = [after(target) + _cash(prices, target - today.keep) for target in today[1:]]
    start, finish = np.stack(lines)[:, :-1], np.stack(lines)[:, 1:]

    # Free volumes: where the value after the day, minus the cost of getting there, peaks.
    middle = moves(schedule, day_rates, t, 0.5 * (points[1:] + points[:-1]))
    for price, inject in ((prices.pay, True), (prices.earn, False)):
        for peak in _peaks(after, price):
            target, values = after.at[peak], after.value[peak]
            floor = np.maximum(middle.down, middle.keep) if inject else middle.down
            ceiling = middle.up if inject else np.minimum(middle.up, middle.keep)
            within = (floor <= target) & (target <= ceiling)
            if within.any():
                line = values - price * (target - today.keep)
                start = np.vstack([start, np.where(within, line[:-1], -np.inf)])
                finish = np.vstack([finish, np.where(within, line[1:], -np.inf)])

    value = _upper_envelope(points, start, finish)
    value = PiecewiseLine(value.at, value.value - holding_cost(schedule, t, value.at))
    return _without_collinear(value)


def best_move(
    schedule,
    interpolation: Interpolation,
    t: int,
    prices: UnitPrices,
    after: PiecewiseLine,
    inventory: float,
) -> float:
    """The inventory at the end of day t with the largest earnings; if several are equal, the one
    with the smallest flow."""
    today = moves(schedule, rates(schedule, interpolation, t), t, np.array([inventory]))
    down, up = today.down[0], today.up[0]
    inside = after.at[(after.at > down) & (after.at < up)]
    targets = np.concatenate([today.hold, today.down, today.up, inside])
    value = after(targets) + _cash(prices, targets - today.keep[0])
    flow = np.abs(targets - today.keep[0])
    as_good = value >= value.max() - COLLINEAR * np.abs(after.value).max()
    return float(targets[as_good][np.argmin(flow[as_good])])


def visited(schedule, interpolation: Interpolation) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and the largest inventory that can be reached from the initial inventory, each
    [T + 1]. On the first days this interval is narrower than the interval of the schedule, which
    has all inventories from which the contract can still be met.
    """
    horizon = len(schedule.steps.forward)
    low, high = np.empty(horizon + 1), np.empty(horizon + 1)
    low[0] = high[0] = schedule.constants.inventory
    for t in range(horizon):
        day_rates = rates(schedule, interpolation, t)
        knots = day_rates.levels
        knots = np.concatenate([[low[t], high[t]], knots[(knots > low[t]) & (knots < high[t])]])
        today = moves(schedule, day_rates, t, knots)
        low[t + 1], high[t + 1] = today.down.min(), today.up.max()
    return low, high


def _cash(prices: UnitPrices, net: np.ndarray) -> np.ndarray:
    return np.where(net > 0, -net * prices.pay, -net * prices.earn)


def _breakpoints(schedule, day_rates: DayRates, t, targets, low, high, scale) -> np.ndarray:
    """The levels at which the value at the start of the day may bend: ratchet levels, and levels
    from which a move ends at a bend of `after`."""
    levels = day_rates.levels
    knots = np.concatenate([[low], levels[(levels > low) & (levels < high)], [high]])
    keep = knots * (1 - schedule.steps.inventory_loss[t])
    most_in = np.interp(knots, levels, day_rates.injection)
    most_out = np.interp(knots, levels, day_rates.withdrawal)
    forced_in, forced_out = schedule.steps.min_injection[t], schedule.steps.min_withdrawal[t]
    reached = [keep, keep + most_in, keep - most_out]
    reached += [keep + forced_in] if forced_in > 0 else []
    reached += [keep - forced_out] if forced_out > 0 else []
    endpoints = np.stack(reached)[:, :, None]  # [moves, knots, targets]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (targets - endpoints[:, :-1]) / np.diff(endpoints, axis=1)
        bends = knots[:-1, None] + share * np.diff(knots)[:, None]
    points = np.sort(np.append(knots, bends[(share > 0) & (share < 1)]))
    points = points[np.append(True, np.diff(points) > SAME * scale)]
    points[-1] = max(high, points[-1])
    return points if len(points) > 1 else np.array([low, low])


def _peaks(line: PiecewiseLine, price) -> np.ndarray:
    """The indices of the local maxima of value - price x inventory (the right end of a plateau)."""
    net = line.value - price * line.at
    left = np.append(-np.inf, net[:-1])
    right = np.append(net[1:], -np.inf)
    return np.flatnonzero((net >= left) & (net > right))


def _upper_envelope(points: np.ndarray, start: np.ndarray, finish: np.ndarray) -> PiecewiseLine:
    """The upper envelope of C lines on each of n intervals; the lines are values at the two ends,
    each [C, n]."""
    value = np.maximum(
        np.append(start.max(axis=0), -np.inf), np.append(-np.inf, finish.max(axis=0))
    )
    best = start.argmax(axis=0)
    column = np.arange(start.shape[1])
    crossed = np.flatnonzero(finish[best, column] < finish.max(axis=0))
    first, end = start[:, crossed], finish[:, crossed]
    one, other = np.triu_indices(len(start), 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        before, after = first[one] - first[other], end[one] - end[other]
        share = before / (before - after)
        pair, k = np.nonzero(np.isfinite(share) & (before * after < 0))
    theta, left = share[pair, k], crossed[k]
    between = np.max(first[:, k] * (1 - theta) + end[:, k] * theta, axis=0)
    at = np.append(points, points[left] + theta * np.diff(points)[left])
    at, order = np.unique(at, return_index=True)
    return PiecewiseLine(at, np.append(value, between)[order])


def _without_collinear(line: PiecewiseLine) -> PiecewiseLine:
    """Removes breakpoints on the chord between their neighbours, but never two neighbours at
    once."""
    at, value = line
    tolerance = COLLINEAR * max(np.abs(value).max(), 1e-300)
    parity, unchanged = 0, 0
    while len(at) > 2 and unchanged < 2:
        share = (at[1:-1] - at[:-2]) / (at[2:] - at[:-2])
        chord = value[:-2] * (1 - share) + value[2:] * share
        straight = np.concatenate([[False], np.abs(value[1:-1] - chord) < tolerance, [False]])
        straight[parity::2] = False
        at, value = at[~straight], value[~straight]
        parity, unchanged = 1 - parity, 0 if straight.any() else unchanged + 1
    return PiecewiseLine(at, value)
