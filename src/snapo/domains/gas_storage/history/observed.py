"""The prices of a back-test: spot prices and forward curves, by the date of publication."""

import datetime
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from snapo.case.csv import FileReference, read_rows, rising_dates
from snapo.case.error import CaseError
from snapo.case.table import TableContext

from ..curves.products import delivery_of

SPOT, CURVES = "spot.csv", "curves.csv"


class ForwardQuote(NamedTuple):
    """The price of delivery from `first` to `last`, both included."""

    first: datetime.date
    last: datetime.date
    price: float


@dataclass(frozen=True, eq=False)
class ObservedMarket:
    """The prices in a folder, by date.

    - `folder`; `spot_days`, `spot_prices`: rising dates, and the spot price of each.
    - `curve_days`, `curves`: rising dates, and the quotes on each; empty without a file of curves.
    """

    folder: Path
    spot_days: tuple[datetime.date, ...]
    spot_prices: tuple[float, ...]
    curve_days: tuple[datetime.date, ...]
    curves: Mapping[datetime.date, Sequence[ForwardQuote]]

    def spot(self, day: datetime.date) -> float:
        """The spot price of a day, or of the last day before it that has one.

        **Raises:** `CaseError` if there is none, or the file ends before the day.
        """
        position = bisect_right(self.spot_days, day) - 1
        if position < 0 or day > self.spot_days[-1]:
            first, last = self.spot_days[0], self.spot_days[-1]
            message = (
                "a back-test needs the spot prices of all its days; the file has those of "
                f"{first} to {last}"
            )
            raise CaseError(str(self.folder / SPOT), day.isoformat(), None, message)
        return self.spot_prices[position]

    def has_curve(self, day: datetime.date) -> bool:
        """Whether a forward curve had been published by a day."""
        return bool(self.curve_days) and self.curve_days[0] <= day

    def curve(self, day: datetime.date, days: Sequence[datetime.date]) -> np.ndarray:
        """[n] the forward prices of days, from the last curve that had been published by a day. A
        day of delivery has the price of the shortest product that contains it; days before the
        first product have the spot price.

        **Raises:** `CaseError` if a later day is in no product.
        """
        latest = self.curve_days[bisect_right(self.curve_days, day) - 1]
        quotes = sorted(self.curves[latest], key=lambda x: (x.last - x.first, x.first))
        first = min(quote.first for quote in quotes)
        prices = []
        for item in days:
            if item < first:
                prices.append(self.spot(day))
                continue
            price = next((x.price for x in quotes if x.first <= item <= x.last), None)
            if price is None:
                message = (
                    f"no product of {latest} has delivery on {item}; the contract needs a price "
                    "for every day"
                )
                raise CaseError(str(self.folder / CURVES), latest.isoformat(), None, message)
            prices.append(price)
        return np.array(prices)


@dataclass(frozen=True, eq=False)
class StepCurves:
    """The prices of a contract: on step t, [T + 1 - t] prices for the day, later days and the end
    date. Step -1 has the prices of the valuation date, [T + 1].

    - `days` [T], `end`: the dates of the contract; `end_price`: whether a price is needed on the
      end date.
    - `spots` [T + 1]: spot prices of the same dates.
    """

    observed: ObservedMarket
    valuation: datetime.date
    days: tuple[datetime.date, ...]
    end: datetime.date
    end_price: bool
    spots: np.ndarray
    _made: dict[int, np.ndarray] = field(default_factory=dict)

    def day(self, t: int) -> datetime.date:
        return self.days[t] if t >= 0 else self.valuation

    @cached_property
    def trading(self) -> frozenset[int]:
        """The steps on which a curve is published."""
        return frozenset(
            t for t in range(-1, len(self.days)) if self.day(t) in self.observed.curves
        )

    def __call__(self, t: int) -> np.ndarray:
        if t == len(self.days):
            return self.spots[t:]
        if t not in self._made:
            dates = (*self.days, self.end) if self.end_price else self.days
            curve = self.observed.curve(self.day(t), dates[max(t, 0) :])
            curve = curve if self.end_price else np.append(curve, curve[-1])
            if t >= 0:
                curve[0] = self.spots[t]
            self._made[t] = curve
        return self._made[t]


def read_observed(folder: Path, lowest: float, notes: list[str]) -> ObservedMarket:
    """Reads `spot.csv` (date,price) and, if it is there, `curves.csv` (date,product,price).

    `lowest`: the number that all prices of the model are above.

    **Raises:** `CaseError` if a file, a date, a product or a price is wrong.
    """
    if not folder.is_dir():
        raise CaseError("--history", "", str(folder), "it must be a folder with spot.csv")
    low, allowed = -np.inf, ""
    if lowest > low:
        low = float(np.nextafter(lowest, np.inf))
        allowed = f"a number above {lowest:.10g}, as all prices of this model are"
    section = TableContext(folder / "history", "history", notes)
    rows = read_rows(FileReference(section, "spot", SPOT), ("date", "price"))
    days = rising_dates(rows)
    spot = [
        (day, row.number("price", low, allowed=allowed))
        for day, row in zip(days, rows)
        if row.cells["price"]
    ]
    if not spot:
        raise CaseError(str(folder / SPOT), "", None, "it has no price")
    curves: dict[datetime.date, list[ForwardQuote]] = {}
    if (folder / CURVES).exists():
        columns = ("date", "product", "price")
        for row in read_rows(FileReference(section, "curves", CURVES), columns):
            first, last = delivery_of(row)
            price = row.number("price", low, allowed=allowed)
            curves.setdefault(row.day("date"), []).append(ForwardQuote(first, last, price))
    spot_days, prices = zip(*spot)
    return ObservedMarket(folder, spot_days, prices, tuple(sorted(curves)), curves)
