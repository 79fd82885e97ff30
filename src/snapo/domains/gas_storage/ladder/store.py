"""A gas store with flat volumes over traded products; see `rolling`."""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..references.day_terms import DayRates, Interpolation, end_value, rates
from ..references.marginal import common_volume
from ..references.piecewise import visited
from .flat import Side

HALVINGS = 32  # of a flat volume, where rates depend on the inventory


class Stock(NamedTuple):
    """The inventories on the days of a period, factor x first level + span x q, and the limits
    after each day.

    - `before`, `after`: (factor, span) [n] at the start and at the end of each day.
    """

    before: tuple[np.ndarray, np.ndarray]
    after: tuple[np.ndarray, np.ndarray]
    low: np.ndarray
    high: np.ndarray


class FlatStore:
    """A `rolling.FlatContract` made from a prepared schedule with NumPy leaves."""

    def __init__(self, schedule, interpolation: Interpolation):
        self.schedule = schedule
        self.horizon = len(schedule.steps.forward)
        self.start = float(schedule.constants.inventory)
        self.measure = common_volume(schedule.steps)
        self._rates = [rates(schedule, interpolation, t) for t in range(self.horizon)]
        self._low, self._high = visited(schedule, interpolation)
        same = [np.ptp(x.injection) == 0 and np.ptp(x.withdrawal) == 0 for x in self._rates]
        self._constant = np.array(same, bool)
        ends = np.unique(schedule.constants.end_levels)
        self.every = not (self._constant.all() and len(ends) <= 1)

    def levels(self, t: int) -> tuple[float, float]:
        return float(self._low[t]), float(self._high[t])

    def reached(self, t: int) -> tuple[float, float]:
        return self.levels(t + 1)

    def growth(self, first: int, after: int) -> tuple[float, float]:
        factor, span = self._stock(first, after).after
        return float(factor[-1]), float(span[-1])

    def limits(self, first, after, levels, low, high):
        stock = self._stock(first, after)
        lows, highs = stock.low.copy(), stock.high.copy()
        lows[-1], highs[-1] = max(low, lows[-1]), min(high, highs[-1])
        factor, span = (x[:, None] for x in stock.after)
        most = np.min((highs[:, None] - factor * levels) / span, axis=0)
        least = np.max((lows[:, None] - factor * levels) / span, axis=0)
        if after - first == 1 or self._constant[first:after].all():
            upper, lower = self._rate_limits(first, after, stock.before[0][:, None] * levels)
            return np.maximum(least, lower.max(axis=0)), np.minimum(most, upper.min(axis=0))
        return self._searched(first, after, levels, least, most, stock)

    def sides(self, first: int, after: int) -> tuple[Side, Side]:
        steps, days = self.schedule.steps, slice(first, after)
        into, out = 1 + steps.injection_fuel[days], 1 - steps.withdrawal_fuel[days]
        paid_in = steps.injection_cost[days] @ steps.injection_cost_discount[days]
        paid_out = steps.withdrawal_cost[days] @ steps.withdrawal_cost_discount[days]
        stored = self._holding(days) @ self._stock(first, after).before[1]
        discount = self.discount(first, after)
        return (
            Side(discount * into, float(into.mean()), float(paid_in + stored)),
            Side(discount * out, float(out.mean()), float(paid_out - stored)),
        )

    def level_cost(self, first: int, after: int, levels: np.ndarray) -> np.ndarray:
        cost = float(self._holding(slice(first, after)) @ self._stock(first, after).before[0])
        return cost * levels

    def end_cost(self, first: int, after: int, levels: np.ndarray) -> None:
        return None

    def discount(self, first: int, after: int) -> np.ndarray:
        return self.schedule.steps.gas_discount[first:after]

    def settled(self, t: int, levels: np.ndarray) -> None:
        return None

    def final(self, levels: np.ndarray, price: np.ndarray) -> np.ndarray:
        return end_value(self.schedule, levels, price)

    def _holding(self, days: slice) -> np.ndarray:
        steps = self.schedule.steps
        return steps.inventory_cost[days] * steps.flow_discount[days]

    def _stock(self, first: int, after: int) -> Stock:
        steps = self.schedule.steps
        left = 1 - np.asarray(steps.inventory_loss[first:after])
        factor, span = np.ones(len(left) + 1), np.zeros(len(left) + 1)
        for k, share in enumerate(left):
            factor[k + 1], span[k + 1] = factor[k] * share, span[k] * share + 1
        limits = steps.next_low[first:after], steps.next_high[first:after]
        return Stock((factor[:-1], span[:-1]), (factor[1:], span[1:]), *limits)

    def _rate_limits(self, first: int, after: int, stock: np.ndarray):
        """[n, levels] the largest and the smallest flow on each day, at inventories on these
        days."""
        steps, days = self.schedule.steps, slice(first, after)
        upper, lower = np.empty_like(stock), np.empty_like(stock)
        for table, rows in self._tables(first, after):
            upper[rows] = np.interp(stock[rows], table.levels, table.injection)
            lower[rows] = -np.interp(stock[rows], table.levels, table.withdrawal)
        forced_out, forced_in = steps.min_withdrawal[days, None], steps.min_injection[days, None]
        return (
            np.where(forced_out > 0, -forced_out, upper),
            np.where(forced_in > 0, forced_in, lower),
        )

    def _tables(self, first: int, after: int) -> list[tuple[DayRates, np.ndarray]]:
        """The different tables of rates on some days, each with its days."""
        numbers = self._numbers[first:after]
        return [(self._rates[first + int(np.argmax(numbers == n))], np.flatnonzero(numbers == n))
                for n in np.unique(numbers)]  # fmt: skip

    @cached_property
    def _numbers(self) -> np.ndarray:
        """[T] the number of the table of rates of each day."""
        first: dict[tuple[bytes, ...], int] = {}
        keys = [tuple(x.tobytes() for x in table) for table in self._rates]
        return np.array([first.setdefault(key, len(first)) for key in keys])

    def _searched(self, first, after, levels, least, most, stock: Stock):
        """The limits of q if rates depend on the inventory, which q itself changes."""
        factor, span = (x[:, None] for x in stock.before)
        fastest = max(table.injection.max() for table in self._rates[first:after])
        slowest = -max(table.withdrawal.max() for table in self._rates[first:after])

        def within(q: np.ndarray, below: bool) -> np.ndarray:
            upper, lower = self._rate_limits(first, after, factor * levels + span * q)
            return np.all(q <= upper if below else q >= lower, axis=0)

        top, bottom = np.minimum(most, fastest), np.maximum(least, slowest)
        return (
            _furthest(lambda q: within(q, False), bottom, np.maximum(bottom, fastest)),
            _furthest(lambda q: within(q, True), top, np.minimum(top, slowest)),
        )


def _furthest(
    possible: Callable[[np.ndarray], np.ndarray], wish: np.ndarray, safe: np.ndarray
) -> np.ndarray:
    """The possible number nearest to `wish`, between `wish` and `safe`."""
    bad, good = wish, np.where(possible(wish), wish, safe)
    if np.array_equal(good, wish):
        return good
    for _ in range(HALVINGS):
        middle = 0.5 * (bad + good)
        inside = possible(middle)
        good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
    return good
