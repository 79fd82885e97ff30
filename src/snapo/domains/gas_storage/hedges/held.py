"""Which products a hedge holds from one trading day to the next.

A position is taken after the flow of the day. Each later day belongs to the shortest product of a
set that contains it and still trades, and tomorrow to the day-ahead, where this is in the set. A
product is closed on its last trading day, unless another one of the set follows on its days.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NamedTuple

from ..ladder.products import BALANCE, DAY_AHEAD, ONE, TradedProducts
from ..ladder.rolling import TradeBlock

DELTAS, LEAST = "deltas", "least variance"


class HeldProduct(NamedTuple):
    """A product of a hedge with its days, and the key of [products] that it is of."""

    name: str
    block: TradeBlock
    family: str


Held = tuple[HeldProduct, ...]


class DailyHedge(NamedTuple):
    """Rebalanced on each day, in the `families` of [products].

    - `rule`: DELTAS: each product its exposure; LEAST: the first product of each family, so that
      the variance of the next day is least.
    """

    rule: str
    families: tuple[str, ...]


def usual_hedges(families: Collection[str]) -> tuple[DailyHedge, ...]:
    """Deltas in longer products, then with shorter ones; least variance in one family, and in all.

    `families`: that trade, the shortest first.
    """
    short = [family for family in families if family in (DAY_AHEAD, BALANCE)]
    longer = tuple(family for family in families if family not in short)
    sets = [longer] if longer else []
    for family in reversed(short):
        sets.append((family, *(sets[-1] if sets else ())))
    alone = [family for family in families if family != BALANCE]
    least = [(family,) for family in alone] + ([tuple(alone)] if len(alone) > 1 else [])
    return (*(DailyHedge(DELTAS, x) for x in sets), *(DailyHedge(LEAST, x) for x in least))


@dataclass(frozen=True, eq=False)
class Overnight:
    """The products that hedges hold from step to step."""

    products: TradedProducts
    _known: dict[tuple[int, frozenset[str]], Held] = field(default_factory=dict)

    def of(self, hedge: DailyHedge, t: int) -> Held:
        """What a hedge holds from step t."""
        families = hedge.families
        return self.nearest(t, families) if hedge.rule == LEAST else self.held(t, families)

    def held(self, t: int, families: Collection[str]) -> Held:
        """What is held from step t on in a set of families of [products]."""
        next_day = {
            day
            for row in self._rows(t + 1, families)
            for day in range(row.block.first, row.block.after)
        }
        return tuple(
            row
            for row in self._rows(t, families)
            if next_day.issuperset(range(max(row.block.first, t + 2), row.block.after))
        )

    def nearest(self, t: int, families: Collection[str]) -> Held:
        """The first product of each family that is held.

        In the last months, where nothing later trades, the balance of the month takes their place.
        """
        first: dict[str, HeldProduct] = {}
        for row in self.held(t, families):
            first.setdefault(row.family, row)
        if set(families) == {DAY_AHEAD} or set(first) - {DAY_AHEAD}:
            return tuple(first.values())
        if self.products.balance is None:
            return tuple(first.values())
        return self.held(t, {*families, BALANCE})[: 1 + (DAY_AHEAD in first)]

    def to_delivery(self) -> Held:
        """The products of the first trading day, in which a static hedge is sold."""
        return self._rows(self.first, set(self.products.families) - {DAY_AHEAD})

    @property
    def first(self) -> int:
        """The first trading day: step 0, or the valuation date for -1."""
        return -1 if self.products.before else 0

    def _rows(self, t: int, families: Collection[str]) -> Held:
        """The products that trade on step t, of days after it."""
        rows = self._named(t, frozenset(families) - {DAY_AHEAD})
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

    def _named(self, t: int, families: frozenset[str]) -> Held:
        if t >= len(self.products.days):
            return ()
        if (t, families) not in self._known:
            rows = self.products.only(families).named(t)
            self._known[t, families] = tuple(
                HeldProduct(name, block, self.products.family(name))
                for name, block in rows
                if block.first > t and block.trades
            )
        return self._known[t, families]

    def _tomorrow(self, t: int) -> bool:
        """Whether the day after the trading day is a day of delivery."""
        days = self.products.days
        if t >= 0:
            return t + 1 < len(days)
        return bool(days) and self.products.valuation + ONE == days[0]


def by_day(horizon: int, first: int) -> Held:
    """Each day after step `first` as if it were a product without a spread."""
    days = range(first + 1, horizon)
    return tuple(HeldProduct("", TradeBlock(t, t + 1), BY_DAY) for t in days)


BY_DAY = "by day"
