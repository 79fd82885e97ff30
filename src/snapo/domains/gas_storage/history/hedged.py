"""The hedges of a back-test, traded on each day with a curve, with the prices up to that day.

Exposures are fitted on paths of the model of the last solution. Each day uses the exposures at its
inventory, price factors and curve. Positions are marked to the curve of each day and deliver at the
spot price; money is discounted to the valuation date.
"""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..contract.records import StorageCase
from ..hedges import DailyHedge
from ..hedges.exposures import FittedExposures, StorePaths
from ..hedges.held import HeldProducts, Overnight
from ..hedges.simulate import DailyHedges, HedgeAccount, HeldVolume, OvernightChange, different
from ..ladder.products import TradedProducts

Curves = Callable[[int], np.ndarray]  # of a step: forward prices of it and of later ones


class HedgeDay(NamedTuple):
    """A hedge on a day: the `gain` of its positions since the day before, without costs, and the
    `cost` and the volume `traded` of the trades of the day."""

    date: datetime.date
    hedge: str
    products: str
    gain: float
    cost: float
    traded: float


class HedgePosition(NamedTuple):
    """A position at the end of a day: `sold` units on each day from `first` to `last`,
    at the mean forward `price`."""

    date: datetime.date
    hedge: str
    products: str
    product: str
    first: datetime.date
    last: datetime.date
    sold: float
    price: float


@dataclass(frozen=True)
class HedgedStore:
    """The result with one hedge.

    - `gain`: the gain of the hedge after its `cost`; `traded`: the volume of all trades.
    - `total`: the total of contract and hedge; `deviation`: the standard deviation of the change of
      this total, marked to the curve, from one solution to the next.
    """

    hedge: str
    products: str
    gain: float
    cost: float
    traded: float
    total: float
    deviation: float


class HedgeBook:
    """The positions of all hedges of a contract over its days.

    - `curves`: the prices that are available on each step of the contract; step -1 is a valuation
      date before the contract.
    - `trading`: the steps at which a curve is published, so that positions can change.
    """

    def __init__(
        self,
        case: StorageCase,
        discount: np.ndarray,
        hedges: Sequence[DailyHedge],
        products: TradedProducts,
        curves: Curves,
        trading: frozenset[int],
    ):
        self.case, self.discount, self.curves, self.trading = case, discount, curves, trading
        self.daily = DailyHedges(Overnight(products, trading), hedges)
        self.held: list[list[HeldVolume]] = [[] for _ in hedges]
        self.days: list[HedgeDay] = []
        self.positions: list[HedgePosition] = []
        self._exposures: FittedExposures | None = None
        self._paths: StorePaths | None = None
        self._start = 0

    @property
    def first(self) -> int:
        """The first step on which a position may be taken."""
        return self.daily.overnight.first

    def solve(self, start: int, after: int, paths: StorePaths) -> None:
        """Fits the exposures of the steps from `start` up to, but not including, `after`, on paths
        that begin at `start`."""
        self._start, self._paths = start, paths
        steps = range(self.first if start == 0 else start, after)
        products = {t - start: different(self._rows(t)) for t in steps if t in self.trading}
        self._exposures = FittedExposures.of(paths, products)

    def trade(self, t: int, inventory: float, factors: np.ndarray) -> None:
        """Marks the positions and trades at the end of step t, after its flow.

        `inventory`: after the flow; `factors` [F]: those of the day.
        """
        marked = [self._marked(held, t) for held in self.held]
        accounts = [HedgeAccount(self.discount, 1) for _ in self.held]
        if t in self.trading:
            now = self._positions(t, inventory, factors)
            for account, old, new in zip(accounts, self.held, now, strict=True):
                account.trade(old, new, t)
            self.held = now
        day = self.case.days[t] if t >= 0 else self.case.valuation_date
        rows = zip(self.daily.hedges, marked, accounts, self.held, strict=True)
        for hedge, gain, account, held in rows:
            about = day, hedge.title, hedge.products
            cost, traded = (
                sum(float(x[0]) for x in amounts.values())
                for amounts in (account.cost, account.traded)
            )
            self.days.append(HedgeDay(*about, gain, cost, traded))
            if t in self.trading:
                self.positions += [HedgePosition(*about, *self._record(t, x)) for x in held]

    def _marked(self, held: Sequence[HeldVolume], t: int) -> float:
        """The gain of positions from the step before to step t."""
        if t <= self.first or not held:
            return 0.0
        change = self.curves(t) - self._ahead(t - 1)
        account = HedgeAccount(self.discount, 1)
        account.hold(held, OvernightChange(self.discount, change[:, None], t - 1))
        return sum(float(x[0]) for x in account.gain.values())

    def _ahead(self, t: int) -> np.ndarray:
        """The prices of the dates after step t, as seen on that step."""
        return self.curves(t)[1:] if t >= 0 else self.curves(t)

    def _positions(self, t: int, inventory: float, factors: np.ndarray) -> list[list[HeldVolume]]:
        paths, exposures, start = self._paths, self._exposures, self._start
        assert paths is not None and exposures is not None
        local, horizon = t - start, paths.horizon
        states, levels = np.zeros((horizon + 1, len(factors), 1)), np.zeros((horizon + 1, 1))
        levels[local + 1] = inventory
        if local >= 0:
            states[local] = factors[:, None]
        part = StorePaths(
            paths.factors, paths.forward, paths.discount, states, levels, levels, np.zeros(1)
        )
        moving = part.paid(local + 1, part.moving(self._ahead(t)[:, None]))
        now = self.daily.positions(exposures, local, part, self._rows(t), moving)
        return [[x._replace(row=_renumbered(x.row, start)) for x in held] for held in now]

    def _rows(self, t: int) -> list[HeldProducts]:
        """The products of each hedge, with days that are counted from the day of the solution."""
        return [
            tuple(_renumbered(row, -self._start) for row in rows) for rows in self.daily.held(t)
        ]

    def _record(self, t: int, held: HeldVolume):
        (name, block, _), volume = held
        first, after = block.first, block.after
        price = self._ahead(t)[first - t - 1 : after - t - 1].mean()
        days = self.case.days
        return name, days[first], days[after - 1], float(volume[0]), float(price)


def _renumbered(row, steps: int):
    """A product with days that are counted from another day."""
    block = row.block
    return row._replace(block=block._replace(first=block.first + steps, after=block.after + steps))


def hedged_results(
    book: HedgeBook, realised: float, marks: Sequence[tuple[datetime.date, float]]
) -> tuple[HedgedStore, ...]:
    """The result of each hedge of a contract whose cash flow was `realised`. `marks`: the date of
    each solution, and the cash flow of the contract up to this date plus its value on this date.
    """
    results = []
    for hedge in book.daily.hedges:
        days = [x for x in book.days if (x.hedge, x.products) == (hedge.title, hedge.products)]
        # A position is marked before the trades of the day.
        sums = [
            value
            + sum(x.gain for x in days if x.date <= day)
            - sum(x.cost for x in days if x.date < day)
            for day, value in marks
        ]
        cost, traded = sum(x.cost for x in days), sum(x.traded for x in days)
        gain = sum(x.gain for x in days) - cost
        total = realised + gain
        amounts = gain, cost, traded, total, change_deviation([*sums, total])
        results.append(HedgedStore(hedge.title, hedge.products, *amounts))
    return tuple(results)


def change_deviation(sums: Sequence[float]) -> float:
    """The standard deviation of the changes; NaN for fewer than two changes."""
    return float(np.std(np.diff(sums), ddof=1)) if len(sums) > 2 else np.nan
