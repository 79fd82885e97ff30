"""A contract of one level and one flow with flat volumes over traded products.

See `gas_storage.ladder.rolling.FlatContract`, which rolling intrinsic and least-squares Monte Carlo
read.
"""

from typing import Any

import numpy as np

from ...gas_storage.ladder.flat import Side
from ..core.contract import ContractLayout
from .measure import common_measure, measures_of


def no_flat_volumes(layout: ContractLayout) -> str:
    """Why the volumes of a contract have no flat ones over products; "" where they do."""
    if layout.indexed:
        return "this method is for contracts whose money does not follow an index"
    if layout.moves or len(layout.flows) != 1 or len(layout.levels) > 1:
        return "this method is for contracts of one flow and at most one level"
    return ""


class FlatVolumes:
    """See `FlatContract`; of a schedule with NumPy leaves."""

    every = False  # the value is concave in the level

    def __init__(self, layout: ContractLayout, schedule: Any):
        if reason := no_flat_volumes(layout):
            raise ValueError(reason)
        terms, intervals = schedule.steps.terms, schedule.steps.intervals
        self.terms, self.horizon = terms, len(terms.most)
        most, zero = np.asarray(terms.most)[:, 0], np.zeros(self.horizon)
        self._restarts = zero.astype(bool)
        if layout.levels:
            start = np.asarray(schedule.constants.start, float)
            self.start, self.measure = float(start[0]), measures_of(layout, terms, start)[0]
            self._restarts = np.asarray(terms.restarts)[:, 0]
            self._effect = layout.flows[0].effects[0]
            low, high = intervals.next_low[:, 0], intervals.next_high[:, 0]
        else:
            self.start, self._effect = 0.0, 1.0
            self.measure = common_measure([*np.unique(most), *np.unique(terms.least)])
            low, high = zero, np.cumsum(most)
        self._low, self._high = np.array(low, float), np.array(high, float)
        self._limit_levels(np.asarray(terms.least)[:, 0] * self._effect, most * self._effect)

    def _limit_levels(self, least: np.ndarray, most: np.ndarray) -> None:
        """Narrows the levels after each step to those that are reached."""
        bottom = top = self.start
        for t in range(self.horizon):
            bottom, top = bottom + min(least[t], most[t]), top + max(least[t], most[t])
            self._low[t] = bottom = max(self._low[t], bottom)
            self._high[t] = top = max(min(self._high[t], top), bottom)
            bottom, top = (0.0, 0.0) if self._restarts[t] else (bottom, top)

    def levels(self, t: int) -> tuple[float, float]:
        if t == 0:
            return self.start, self.start
        return (0.0, 0.0) if self._restarts[t - 1] else self.reached(t - 1)

    def reached(self, t: int) -> tuple[float, float]:
        return float(self._low[t]), float(self._high[t])

    def limits(self, first, after, levels, low, high):
        terms, days = self.terms, slice(first, after)
        span = self._effect * np.arange(1, after - first + 1)[:, None]
        lows, highs = self._low[days, None].copy(), self._high[days, None].copy()
        lows[-1], highs[-1] = max(low, lows[-1, 0]), min(high, highs[-1, 0])
        bounds = np.stack([(lows - levels) / span, (highs - levels) / span])
        least, most = bounds.min(axis=0).max(axis=0), bounds.max(axis=0).min(axis=0)
        forced, free = terms.least[days, 0].max(), terms.most[days, 0].min()
        return np.maximum(least, forced), np.minimum(most, free)

    def growth(self, first: int, after: int) -> tuple[float, float]:
        return 1.0, self._effect * (after - first)

    def sides(self, first: int, after: int) -> tuple[Side, Side]:
        price = np.asarray(self.terms.price)[first:after, 0]
        money = float(np.sum(self.terms.money[first:after, 0]))
        return Side(-price, -float(np.sign(price).mean()), -money), Side(0.0 * price, 0.0, 0.0)

    def level_cost(self, first: int, after: int) -> float:
        return 0.0

    def discount(self, first: int, after: int) -> np.ndarray:
        return np.abs(np.asarray(self.terms.price)[first:after, 0])

    def settled(self, t: int, levels: np.ndarray) -> np.ndarray | None:
        if not self._restarts[t]:
            return None
        missed = np.maximum(self.terms.owed[t, 0] - levels, 0.0)
        return self.terms.short[t, 0] * missed

    def final(self, levels: np.ndarray, price: np.ndarray) -> np.ndarray:
        return np.zeros_like(levels + 0.0 * price)
