"""Reads `[market]`: the forward curve by day, zero rates, and when gas is paid."""

import calendar
import datetime
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from snapo.case.csv import Mention, Row, read_rows
from snapo.case.dates import ordinals, rising_dates
from snapo.case.error import CaseError
from snapo.case.given import Given
from snapo.case.table import Section

from ..contract.records import Market
from .settlement import payment_days
from .tables import MarketTable

# All that is said about a zero rate; see `Given`. It is moved by ten basis points.
RATE: dict[str, Any] = {
    "unit": "1/year",
    "move": 0.001,
    "trade_unit": "bp",
    "trade_factor": 10_000.0,
    "group": "interest rate",
    "words": "continuous zero rate",
}


def read_market(
    section: Section,
    table: MarketTable,
    days: Sequence[datetime.date],
    price_days: Sequence[datetime.date],
    moving: np.ndarray,
    unit: str,
) -> Market:
    """The market of a contract that trades on `days` and needs prices on `price_days`.

    `moving`: [T] whether gas can move on the day.
    """
    curve = read_curve(section, table.forward_curve, price_days, unit)
    rate, rate_day = _read_rates(section, table)
    valuation = table.valuation_date
    gas_day = payment_days(section, "settlement", table.settlement, days, valuation, moving)
    return Market(curve, rate, rate_day, gas_day)


def read_curve(section: Section, name: str, days: Sequence[datetime.date], unit: str) -> Given:
    """The forward price of each of `days`, from a CSV of daily and monthly quotes."""
    rows = read_rows(Mention(section, "forward_curve", name), ("date", "price"))
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
            what = (
                "there is no price for this day; the contract needs a quote for every day, or "
                f"its month, from {days[0]} to {days[-1]}"
            )
            raise CaseError(name, day.isoformat(), None, what)
        prices.append(price)
    labels = tuple(day.isoformat() for day in days)
    values = np.array(prices, np.float64)
    said: dict[str, Any] = {"group": "price", "words": "price today for delivery on the day"}
    return Given("forward_curve", values, labels, unit, np.arange(len(days)), **said)


Quotes = tuple[Mapping[datetime.date, float], Mapping[tuple[int, int], float]]


def quotes(rows: Sequence[Row]) -> Quotes:
    """Prices by day and by (year, month), each quoted once; in any order."""
    by_day: dict[datetime.date, float] = {}
    by_month: dict[tuple[int, int], float] = {}
    for row in rows:
        price = row.number("price")
        period = row.period("date")
        if period is None:
            raise row.error("date", "a day is written YYYY-MM-DD, a whole month YYYY-MM")
        _once(by_month if isinstance(period, tuple) else by_day, period, price, row)
    return by_day, by_month


def _once(known: dict, period: Any, price: float, row: Row) -> None:
    if period in known:
        raise row.error("date", "this period has a price already, further up")
    known[period] = price


def month_days(year: int, month: int) -> list[datetime.date]:
    """All days of a month."""
    count = calendar.monthrange(year, month)[1]
    return [datetime.date(year, month, day) for day in range(1, count + 1)]


def _read_rates(section: Section, table: MarketTable) -> tuple[Given, np.ndarray]:
    given = table.interest_rate
    if not isinstance(given, str):
        rate = Given("interest_rate", np.array([given]), ("",), index=np.arange(1), **RATE)
        return rate, np.zeros(1, np.int64)
    rows = read_rows(Mention(section, "interest_rate", given), ("date", "zero_rate"))
    dates = rising_dates(rows)
    # A rate of 1 is 100 % a year: larger ones are percentages that were not divided by 100.
    values = np.array([row.number("zero_rate", -1.0, 1.0) for row in rows])
    labels = tuple(date.isoformat() for date in dates)
    rate = Given("interest_rate", values, labels, index=np.arange(len(values)), **RATE)
    return rate, ordinals(dates) - table.valuation_date.toordinal()
