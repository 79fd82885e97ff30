"""Hours of the local calendar: the steps of a contract, with their prices and times."""

import datetime
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows, rising_dates
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import KeyContext, Quantity
from snapo.case.table import CaseTable, Nonempty, TableContext, doc

from ...gas_storage.contract.records import GasMarket
from ...gas_storage.prices.process import Times
from ...gas_storage.read.tables import FORWARD, ZERO_RATE, Currency, ValuationDay

HOURS = 8760.0  # of a year of 365 days
TIME = "a date or a time of the hour, 2026-05-01T00:00:00"
FIELDS = ("time", "price")
# Without a time zone: that of the case holds. Seconds may be written where they are zero.
HOUR = re.compile(r"(\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2})?)(:00(\.0+)?)?", re.ASCII)


class HourlyQuantity(Quantity):
    """A number, or the name of a CSV with a number for each hour, which is read with
    `rows_by_hour`."""

    def read(self, raw: Any, key: KeyContext) -> Any:
        return raw if isinstance(raw, str) and raw else super().read(raw, key)


HourlyCurve = Annotated[
    Nonempty,
    doc(
        "price today by hour of delivery, in currency/MWh",
        allowed="a CSV file with columns time,price",
    ),
]


class HourlyContractTable(CaseTable):
    """The keys of `[contract]` that all hourly contracts have: unit, first and last hour, local
    calendar."""

    volume_unit: Nonempty = doc("unit of all volumes", "MWh", '"MWh"', pattern="^MWh$")
    currency: Currency
    start: Any = doc("first hour with a decision, in local time", allowed=TIME)
    end: Any = doc("first hour without a decision, in local time", allowed=TIME)
    time_zone: Nonempty = doc("time zone of all hours", "UTC", 'a name such as "Europe/Berlin"')


class HourlyMarketTable(CaseTable):
    """`[market]` of an hourly contract."""

    valuation_date: ValuationDay
    forward_curve: HourlyCurve
    interest_rate: CaseInput = ZERO_RATE("continuous zero rate", 0.0)


@dataclass(frozen=True, eq=False)
class Hours:
    """The decision hours, and the delivery of a price process (see `Delivery`).

    - `instants` [T]: the hours in UTC; `days` [T]: the local date of each hour; `end`: the date of
      the end.
    - `ahead` [T + 1]: the hours from midnight (local time) of the valuation date to each hour, or
      to the auction at which the flow of this hour is fixed; `notice`: the hours from the auction
      to the hour, if there are auctions.
    - `curve`: the forward price of each hour; None until it has been read.
    """

    instants: tuple[datetime.datetime, ...]
    local: tuple[str, ...]
    days: tuple[datetime.date, ...]
    end: datetime.date
    valuation: datetime.date
    ahead: tuple[int, ...]
    curve: Any = None
    notice: tuple[int, ...] | None = None

    @property
    def nominated(self) -> None:
        """None: no flow is fixed some days before its hour."""
        return None

    @property
    def price_days(self) -> tuple[datetime.date, ...]:
        """The dates of the prices."""
        return self.days

    @property
    def dates(self) -> tuple[datetime.date, ...]:
        """[T + 1] the date of each hour, and the end date."""
        return (*self.days, self.end)

    @property
    def times(self) -> Times:
        """The times of the prices, in years."""
        notice = None if self.notice is None else np.array(self.notice) / HOURS
        return Times.of(self.ahead, HOURS, self.curve, notice)


def hours_of(where: TableContext, table: Any, valuation: datetime.date) -> Hours:
    """The hours of a contract: from `start`, or the valuation date, to `end`, local time."""
    try:
        zone = ZoneInfo(table.time_zone)
    except (ZoneInfoNotFoundError, ValueError):
        message = 'this is not the name of a time zone, such as "Europe/Berlin"'
        raise where.error("time_zone", table.time_zone, message) from None
    first = max(_instant(where, "start", table.start, zone), _utc(valuation, zone))
    last = _instant(where, "end", table.end, zone)
    count = int((last - first).total_seconds() // 3600)
    if count < 1:
        raise where.error("end", table.end, "the end must come after the start")
    instants = tuple(first + datetime.timedelta(hours=n) for n in range(count))
    shown = [instant.astimezone(zone) for instant in instants]
    ahead = int((first - _utc(valuation, zone)).total_seconds() // 3600)
    return Hours(
        instants,
        tuple(x.strftime("%Y-%m-%dT%H:%M") for x in shown),
        tuple(x.date() for x in shown),
        last.astimezone(zone).date(),
        valuation,
        tuple(ahead + n for n in range(count + 1)),
    )


def _utc(day: datetime.date, zone: ZoneInfo) -> datetime.datetime:
    local = datetime.datetime(day.year, day.month, day.day, tzinfo=zone)
    return local.astimezone(datetime.UTC)


def _instant(where: TableContext, key: str, value: Any, zone: ZoneInfo) -> datetime.datetime:
    """A date or a local time of the TOML file, in UTC."""
    if isinstance(value, datetime.datetime) and value.tzinfo is None:
        if value.minute or value.second:
            raise where.error(key, value, f"it must be {TIME}")
        return value.replace(tzinfo=zone).astimezone(datetime.UTC)
    if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        return _utc(value, zone)
    raise where.error(key, value, f"it must be {TIME}")


def read_hourly(
    section: TableContext, table: HourlyMarketTable, hours: Hours, unit: str
) -> GasMarket:
    """The market with prices by the hour and interest rates by the day."""
    return hourly_market(hourly_curve(section, table.forward_curve, hours, unit), table, hours)


def hourly_market(curve: CaseInput, table: Any, hours: Hours) -> GasMarket:
    """This hourly curve, with the daily interest rates of a table `[market]`."""
    rate = table.interest_rate
    day = np.array([(date - table.valuation_date).days for date in hours.days], np.int64)
    starts = rate.starts
    nodes = np.zeros(1, np.int64) if starts is None else starts - table.valuation_date.toordinal()
    return GasMarket(curve, replace(rate, index=np.arange(len(rate.values))), nodes, day)


def hourly_curve(
    section: TableContext, file: str, hours: Hours, unit: str, name: str = "forward_curve"
) -> CaseInput:
    """The forward price of each hour, see `rows_by_hour`."""
    rows = rows_by_hour(FileReference(section, "forward_curve", file), hours)
    return _input(name, rows, hours.local, unit, "hour")


def rows_by_hour(reference: FileReference, hours: Hours) -> list[Row]:
    """[T] the row of the file for each hour, by its local time; an hour that occurs twice has two
    rows.

    **Raises:** `CaseError` for an hour without a price, and for a row between the first and the
    last hour that repeats an hour, or whose hour does not exist.
    """
    rows, file = read_rows(reference, FIELDS), reference.name
    by_hour: dict[str, list[Row]] = {}
    for row in rows:
        by_hour.setdefault(_local_hour(row), []).append(row)
    first, last, needed = hours.local[0], hours.local[-1], Counter(hours.local)
    seen: Counter[str] = Counter()
    prices = []
    for label in hours.local:
        place = seen[label]
        seen[label] += 1
        if place >= len(by_hour.get(label, ())):
            message = f"there is no price for this hour; each hour from {first} to {last} needs one"
            raise CaseError(file, label, None, message)
        prices.append(by_hour[label][place])
    for label, of_hour in by_hour.items():
        if first <= label <= last and len(of_hour) > needed[label]:
            row = of_hour[needed[label]]
            if label in needed:
                before = of_hour[0].line
                raise row.error("time", f"this hour already has a price, on line {before}")
            message = f"there is no such hour from {first} to {last} in the time zone of the case"
            raise row.error("time", message)
    return prices


def _local_hour(row: Row) -> str:
    """The hour of a row, such as 2026-05-01T07:00; a date without an hour is the first hour of that
    day."""
    match = HOUR.fullmatch(row.cells["time"])
    try:
        if match is not None:
            return f"{datetime.datetime.fromisoformat(match[1]):%Y-%m-%dT%H:%M}"
    except ValueError:
        pass
    raise row.error("time", "an hour of local time must be written like 2026-05-01T07:00")


def dated_curve(
    section: TableContext, file: str, hours: Hours, unit: str, name: str = "forward_curve"
) -> CaseInput:
    """The price of each day, for all of its hours; index [T]."""
    rows = read_rows(FileReference(section, "forward_curve", file), ("date", "price"))
    by_day = dict(zip(rising_dates(rows, "date"), rows))
    dates = sorted(set(hours.days))
    for day in dates:
        if day not in by_day:
            message = f"there is no price for this day; each day from {dates[0]} to "
            raise CaseError(file, day.isoformat(), None, f"{message}{dates[-1]} needs one")
    labels = [day.isoformat() for day in dates]
    curve = _input(name, [by_day[day] for day in dates], labels, unit, "day")
    return replace(curve, index=np.array([dates.index(day) for day in hours.days]))


def _input(
    name: str, rows: Sequence[Any], labels: Sequence[str], unit: str, period: str
) -> CaseInput:
    forward = replace(FORWARD, unit=unit, meaning=f"price today for delivery in the {period}")
    values = [FORWARD.cell(row) for row in rows]
    cells = tuple(row.position("price") for row in rows)
    return forward.input(name, values, labels, positions=cells)
