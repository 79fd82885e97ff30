"""Reads `[market]`: the forward curve by day, zero rates, and when gas is paid."""

import calendar
import datetime
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput, SheetCell
from snapo.case.table import TableContext

from ..contract.records import GasMarket
from .settlement import payment_days
from .tables import FORWARD, MarketTable


def read_market(
    section: TableContext,
    table: MarketTable,
    days: Sequence[datetime.date],
    price_days: Sequence[datetime.date],
    moving: np.ndarray,
    unit: str,
) -> GasMarket:
    """The market of a contract that trades on `days` and needs prices on `price_days`.

    `moving`: [T] whether gas can move on the day.
    """
    curve = read_curve(section, table.forward_curve, price_days, unit)
    valuation = table.valuation_date
    rate, rate_day = _nodes(table.interest_rate, valuation)
    gas_day = payment_days(section, "settlement", table.settlement, days, valuation, moving)
    return GasMarket(curve, rate, rate_day, gas_day)


def read_curve(
    section: TableContext, name: str, days: Sequence[datetime.date], unit: str
) -> CaseInput:
    """The forward price of each of `days`, from a CSV of daily and monthly quotes."""
    rows = read_rows(FileReference(section, "forward_curve", name), ("date", "price"))
    by_day, by_month = quotes(rows)
    both = [day for day in days if day in by_day and (day.year, day.month) in by_month]
    if both:
        more = f" and {len(both) - 1} more days have" if len(both) > 1 else " has"
        section.notes.append(
            f"In {name} {both[0]}{more} a quote of the day and one of the month: the day's counts."
        )
    prices = []
    for day in days:
        price = by_day.get(day, by_month.get((day.year, day.month)))
        if price is None:
            message = (
                "there is no price for this day; the contract needs a quote for every day, or "
                f"its month, from {days[0]} to {days[-1]}"
            )
            raise CaseError(name, day.isoformat(), None, message)
        prices.append(price)
    labels = [day.isoformat() for day in days]
    forward = replace(FORWARD, unit=unit)
    positions = tuple(price.cell for price in prices)
    return forward.input(
        "forward_curve", [price.value for price in prices], labels, positions=positions
    )


class Quote(NamedTuple):
    """A price of the curve and its position."""

    value: float
    cell: SheetCell


CurveQuotes = tuple[Mapping[datetime.date, Quote], Mapping[tuple[int, int], Quote]]


def quotes(rows: Sequence[Row]) -> CurveQuotes:
    """Prices by day and by (year, month), each quoted once; in any order."""
    by_day: dict[datetime.date, Quote] = {}
    by_month: dict[tuple[int, int], Quote] = {}
    for row in rows:
        price = Quote(FORWARD.cell(row), row.position("price"))
        period = row.period("date")
        if period is None:
            raise row.error("date", "a day is written YYYY-MM-DD, a whole month YYYY-MM")
        _once(by_month if isinstance(period, tuple) else by_day, period, price, row)
    return by_day, by_month


def _once(quotes: dict, period: Any, price: Quote, row: Row) -> None:
    if period in quotes:
        raise row.error("date", "this period has a price already, further up")
    quotes[period] = price


def month_days(year: int, month: int) -> list[datetime.date]:
    """All days of a month."""
    count = calendar.monthrange(year, month)[1]
    return [datetime.date(year, month, day) for day in range(1, count + 1)]


def _nodes(rate: CaseInput, valuation: datetime.date) -> tuple[CaseInput, np.ndarray]:
    """The rates of all nodes, and their days since the valuation date."""
    starts = rate.starts
    days = np.zeros(1, np.int64) if starts is None else starts - valuation.toordinal()
    return replace(rate, index=np.arange(len(rate.values))), days
