"""The products that a hedge holds from one trading day to the next.

A position is taken after the flow of the day. Each later day belongs to the shortest product of a
set that contains it and can still be traded; tomorrow belongs to the day-ahead, if that is in the
set. A position in a product is closed on the last trading day of the product, unless another
product of the set then contains its days.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NamedTuple

from ..ladder.products import BALANCE, DAY_AHEAD, ONE, TradedProducts
from ..ladder.rolling import TradeBlock
from . import MIN_VARIANCE, DailyHedge

BY_DAY = "by day"  # the family of a static hedge of each day


class HeldProduct(NamedTuple):
    """A product of a hedge with its days, and the key of [products] to which it belongs."""

    name: str
    block: TradeBlock
    family: str


HeldProducts = tuple[HeldProduct, ...]


@dataclass(frozen=True, eq=False)
class Overnight:
    """The products that hedges hold from step to step.

    `trading`: the steps on which products can be traded; None if all are such steps.
    """

    products: TradedProducts
    trading: frozenset[int] | None = None
    _cached: dict[tuple[int, frozenset[str]], HeldProducts] = field(default_factory=dict)

    def of(self, hedge: DailyHedge, t: int) -> HeldProducts:
        """The products that a hedge holds from step t on."""
        families = hedge.families
        return self.nearest(t, families) if hedge.rule == MIN_VARIANCE else self.held(t, families)

    def held(self, t: int, families: Collection[str]) -> HeldProducts:
        """The products of some `families` of [products] that are held from step t on."""
        after = self.after(t)
        later = {
            day
            for row in self._rows(after, families)
            for day in range(row.block.first, row.block.after)
        }
        return tuple(
            row
            for row in self._rows(t, families)
            if later.issuperset(range(max(row.block.first, after + 1), row.block.after))
        )

    def after(self, t: int) -> int:
        """The next step on which products can be traded; the number of days if there is none."""
        if self.trading is None:
            return t + 1
        return min((x for x in self.trading if x > t), default=len(self.products.days))

    def nearest(self, t: int, families: Collection[str]) -> HeldProducts:
        """The first product of each family that is held.

        In the last months, if no later product can be traded, the balance of the month replaces
        them.
        """
        first: dict[str, HeldProduct] = {}
        for row in self.held(t, families):
            first.setdefault(row.family, row)
        if set(families) == {DAY_AHEAD} or set(first) - {DAY_AHEAD}:
            return tuple(first.values())
        if self.products.balance is None:
            return tuple(first.values())
        return self.held(t, {*families, BALANCE})[: 1 + (DAY_AHEAD in first)]

    def to_delivery(self) -> HeldProducts:
        """The products of the first trading day; a static hedge is sold in these products."""
        return self._rows(self.first, set(self.products.families) - {DAY_AHEAD})

    @property
    def first(self) -> int:
        """The first trading day: step 0, or -1 for the valuation date."""
        return -1 if self.products.before else 0

    def _rows(self, t: int, families: Collection[str]) -> HeldProducts:
        """The products that can be traded on step t, with the days after it."""
        rows = self._trading(t, frozenset(families) - {DAY_AHEAD})
        if DAY_AHEAD not in families or not self._tomorrow(t):
            return rows
        first = t + 1
        block = TradeBlock(first, first + 1, self.products.day_ahead / 2)
        later = [
            row._replace(block=row.block._replace(first=max(row.block.first, first + 1)))
            for row in rows
            if row.block.after > first + 1
        ]
        return HeldProduct("day ahead", block, DAY_AHEAD), *later

    def _trading(self, t: int, families: frozenset[str]) -> HeldProducts:
        if t >= len(self.products.days):
            return ()
        if (t, families) not in self._cached:
            rows = self.products.only(families).named(t)
            self._cached[t, families] = tuple(
                HeldProduct(name, block, self.products.family(name))
                for name, block in rows
                if block.first > t and block.trades
            )
        return self._cached[t, families]

    def _tomorrow(self, t: int) -> bool:
        """Whether the day after the trading day is a day of delivery."""
        days = self.products.days
        if t >= 0:
            return t + 1 < len(days)
        return bool(days) and self.products.valuation + ONE == days[0]


def by_day(horizon: int, first: int) -> HeldProducts:
    """Each day after step `first`, as a product without a spread."""
    days = range(first + 1, horizon)
    return tuple(HeldProduct("", TradeBlock(t, t + 1), BY_DAY) for t in days)
