"""A contract as traded products see it: the same volume flows on each day of a period.

The contract is a level (gas in store, or volume taken) that a daily volume q changes. The best q of
a path, the same on all days of a period, is exact if the value after the period is concave in the
level, since the slope of the earnings is constant between q = 0, the volume that is already held,
and the limits. If the value is not concave, the limits are also tried.
"""

from typing import NamedTuple

import numpy as np


class Side(NamedTuple):
    """The cost of a unit of q, for one sign of q, in a period of n days.

    - `weight` [n]: the volume bought for q = 1 on each day, times the discount factor of its
      payment; negative if it is sold.
    - `volume`: the volume bought per day, the mean over the days.
    - `money`: the discounted cost of q = 1 in addition to the price.
    """

    weight: np.ndarray
    volume: float
    money: float


class FlatPeriod(NamedTuple):
    """Consecutive days with the same flow, on nodes of the level before and after them.

    - `first`, `after`: the first day, and the day after the last one.
    - `nodes` [m]: evenly spaced levels before the period; `keep` [m]: the level after it without
      any flow.
    - `span`: the change of the level after the period for q = 1.
    - `minimum`, `maximum` [m]: the limits of q; if no q is possible, the first is above the second.
    - `into`, `out`: the sides of q above and below zero.
    - `cost` [m]: the cost of the level itself; `spread`: the discounted cost of the trades of one
      unit on every day.
    """

    first: int
    after: int
    nodes: np.ndarray
    keep: np.ndarray
    span: float
    minimum: np.ndarray
    maximum: np.ndarray
    into: Side
    out: Side
    cost: np.ndarray
    spread: float = 0.0


class Limits(NamedTuple):
    """`keep`, `minimum`, `maximum` and `cost` of a period, at levels between nodes."""

    keep: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray
    cost: np.ndarray


class Slopes(NamedTuple):
    """The earnings of q = 1 on each path [N], for q below and above zero, and the volume that is
    already held.

    - `held`: the volume per day that positions have bought; `zero`: the q that delivers this
      volume.
    """

    out: np.ndarray
    into: np.ndarray
    held: np.ndarray
    zero: np.ndarray


def slopes(period: FlatPeriod, forward: np.ndarray, held: np.ndarray) -> Slopes:
    """The slopes at the forward prices [n, N] of the days of a period, with positions `held`
    [N]."""
    into = -(period.into.weight @ forward) - period.into.money
    out = -(period.out.weight @ forward) + period.out.money
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.where(held * period.into.volume > 0, held / period.into.volume, 0.0)
        behind = np.where(held * period.out.volume < 0, held / period.out.volume, 0.0)
    return Slopes(out, into, held, ahead + behind)


def earned(period: FlatPeriod, slope: Slopes, q: np.ndarray) -> np.ndarray:
    """The money of q [..., N], without that of the positions held, at the prices of the paths."""
    money = np.where(q > 0, slope.into, slope.out) * q
    if period.spread:
        money -= period.spread * np.abs(bought(period, q) - slope.held)
    return money


def bought(period: FlatPeriod, q: np.ndarray) -> np.ndarray:
    """The volume that q buys in the market on a day."""
    return np.where(q > 0, period.into.volume, period.out.volume) * q


class Peaks(NamedTuple):
    """`levels`: for each slope, the best levels [N] after a period; `later` [m, N]: the value at
    the `nodes` after it."""

    levels: list[np.ndarray]
    later: np.ndarray
    nodes: np.ndarray


def peaks(period: FlatPeriod, slope: Slopes, later: np.ndarray, nodes: np.ndarray) -> Peaks:
    """The best levels for the value `later` on the nodes after the period."""
    levels = []
    for unit in _units(period, slope):
        net = later + (unit / period.span) * nodes[:, None]
        levels.append(nodes[np.argmax(net, axis=0)])
    return Peaks(levels, later, nodes)


def best(
    period: FlatPeriod, at: Limits, slope: Slopes, peak: Peaks, every: bool
) -> tuple[np.ndarray, np.ndarray]:
    """[rows, N] the value before the period and the best q, at levels with limits [rows, 1 or N].

    `every`: whether the limits are also tried, which is needed if the value is not concave.
    """
    first, last = np.minimum(slope.zero, 0.0), np.maximum(slope.zero, 0.0)
    parts = [
        (at.minimum, np.minimum(at.maximum, first)),
        (np.maximum(at.minimum, last), at.maximum),
    ]
    if period.spread:
        parts.insert(1, (np.maximum(at.minimum, first), np.minimum(at.maximum, last)))
    tries = []
    for (low, high), level in zip(parts, peak.levels):
        q = np.clip((level - at.keep) / period.span, low, np.maximum(low, high))
        tries.append(np.clip(q, at.minimum, at.maximum))
    tries += [at.minimum, at.maximum] if every else []
    value, chosen = None, None
    for q in tries:
        gain = interpolated(peak.later, peak.nodes, at.keep + period.span * q) + earned(
            period, slope, q
        )
        if value is None or chosen is None:
            value, chosen = gain, np.broadcast_to(q, gain.shape)
        else:
            chosen = np.where(gain > value, q, chosen)
            value = np.maximum(gain, value)
    assert value is not None and chosen is not None
    return value - at.cost, chosen


def limits_at(period: FlatPeriod, levels: np.ndarray) -> Limits:
    """The limits at these levels, linear between the nodes of the period."""
    rows = (period.keep, period.minimum, period.maximum, period.cost)
    return Limits(*(np.interp(levels, period.nodes, row)[None] for row in rows))


def limits_on(period: FlatPeriod) -> Limits:
    """The limits on the nodes, one row for each node."""
    rows = (period.keep, period.minimum, period.maximum, period.cost)
    return Limits(*(row[:, None] for row in rows))


def _units(period: FlatPeriod, slope: Slopes) -> list[np.ndarray]:
    """The earnings of one more unit of q below the first kink, between the two kinks, and above the
    last kink."""
    if not period.spread:
        return [slope.out, slope.into]
    into, out = (period.spread * abs(side.volume) for side in (period.into, period.out))
    below, behind = slope.out + out, slope.out - out
    ahead, above = slope.into + into, slope.into - into
    return [below, np.where(slope.zero > 0, ahead, behind), above]


def interpolated(later: np.ndarray, nodes: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """[rows, N] the values at levels [rows, N], from values [nodes, N]: linear between nodes,
    constant beyond them."""
    count, paths = len(nodes), later.shape[1]
    if count == 1:
        return np.broadcast_to(later, (len(levels), paths))
    position = (levels - nodes[0]) * ((count - 1) / (nodes[-1] - nodes[0]))
    position = np.clip(position, 0.0, count - 1.0)
    left = np.minimum(position.astype(np.int32), count - 2)
    share = position - left
    flat = left * paths + np.arange(paths, dtype=np.int32)
    below = later.ravel().take(flat)
    return below + share * (later.ravel().take(flat + paths) - below)
