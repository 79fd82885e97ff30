"""Reads a calibration: a TOML file of kind "calibration", and the CSVs of prices next to it."""

import calendar
import datetime
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows, rising_dates
from snapo.case.error import CaseError, nearest
from snapo.case.load import load
from snapo.case.table import CaseTable, Positive, TableContext, Title, doc, optional, parse

from ..curves.products import delivery_of
from ..read.tables import DATE, DateKey
from .kalman import History
from .model import HistoryModel

KIND = "calibration"
YEAR = 365.0
FEWEST = 20  # dates
LONGEST = 92  # days of a product, whose price is taken as that of its middle
MONTHS = re.compile(r"[a-z_ ]*(\d{1,3})", re.ASCII)
LATEST = 1200  # months to delivery


class CalibrationTable(CaseTable):
    """The whole file."""

    kind: Literal["calibration"] = doc("kind of the file")
    title: Title = ""
    history: Any = doc("past prices", allowed="a table, [history]")
    model: Any = doc("model that is estimated", allowed="a table, [model]")


@optional("step", note=": years between two dates, instead of their days / 365")
class HistoryTable(CaseTable):
    """`[history]`"""

    spot: str | None = doc("spot prices", None, "a CSV file with columns date,price")
    quotes: str | None = doc(
        "past prices of traded products", None, "a CSV file with columns date,product,price"
    )
    maturities: str | None = doc(
        "forward prices by time to delivery", None,
        "a CSV file with a column date, and a column of prices for each time to delivery in months",
    )  # fmt: skip
    first: DateKey | None = doc("first date used", None, f"{DATE}: earlier prices are left out")
    last: DateKey | None = doc("last date used", None, f"{DATE}: later prices are left out")
    step: Positive = doc("time from one date to the next, in years")
    exact: list[str] | None = doc(
        "series without a measurement error", None, 'names of series, such as ["spot"]'
    )
    season: Literal[0, 1, 2] = doc("number of waves of the seasonal pattern in a year", 0)


@optional("shift", note=": all prices are above minus this number")
class GaussianTable(CaseTable):
    """`[model]` of a calibration."""

    kind: Literal["one-factor", "one-factor-normal", "one-factor-shifted", "multi-factor"] = doc(
        "kind of the price model"
    )
    shift: Positive = doc("shift of the prices")


FORMATS = {"": CalibrationTable, "history": HistoryTable, "model": GaussianTable}


class ObservedPrice(NamedTuple):
    """A price on a date: its series, years to delivery, time of delivery as a share of the year,
    and its cell if it was read from a file."""

    day: datetime.date
    series: str
    years: float
    phase: float
    price: float
    row: Row | None = None
    column: str = ""

    def error(self, message: str) -> CaseError:
        """An error about this price, with its cell if it has one."""
        if self.row is None:
            return CaseError(self.series, self.day.isoformat(), self.price, message)
        return self.row.error(self.column, message)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration that was read.

    - `file`, `title`: the file and its title; `days` [N]: the days with prices; `prices`: the
      number of prices.
    - `model`, `history`: the model and the prices, in the form that the filter needs. `notes`:
      notes for the user.
    """

    file: Path
    title: str
    days: tuple[datetime.date, ...]
    prices: int
    model: HistoryModel
    history: History
    notes: tuple[str, ...]


def read_calibration(path: Path) -> Calibration:
    """Reads the file of a calibration, or the folder with its case.toml.

    **Raises:** `CaseError` if a key or a price is wrong, with file, line and column.
    """
    file, data = load(path)
    top = parse(CalibrationTable, data, str(file), "")
    notes: list[str] = []
    table = parse(HistoryTable, top.history, str(file), "history", notes)
    model = parse(GaussianTable, top.model, str(file), "model", notes)
    section = TableContext(file, "history", notes)
    if (model.kind == "one-factor-shifted") != (model.shift is not None):
        message = (
            'kind "one-factor-shifted" needs a shift above 0, and no other kind may have a shift'
        )
        raise TableContext(file, "model", notes).error("shift", model.shift, message)
    first, last = table.first or datetime.date.min, table.last or datetime.date.max
    if first > last:
        raise section.error("last", table.last, f"it must be a date that is not before {first}")
    if table.spot is None and table.quotes is None and table.maturities is None:
        message = "[history] must name at least one file: spot, quotes or maturities"
        raise section.error("spot", None, message)
    prices = [price for price in _prices(section, table) if first <= price.day <= last]
    if not prices:
        raise section.error("first", table.first, f"there is no price from {first} to {last}")
    return calibration_of(section, table, model.kind, model.shift or 0.0, prices, top.title)


def calibration_of(
    section: TableContext,
    table: HistoryTable,
    kind: str,
    shift: float,
    prices: Sequence[ObservedPrice],
    title: str = "",
) -> Calibration:
    """The calibration of a model of this kind on prices, with the settings of [history].

    **Raises:** `CaseError` if there are too few prices, or a price that the model does not allow.
    """
    normal = kind == "one-factor-normal"
    if not normal:
        _check_sign(prices, shift)
    days = tuple(sorted({price.day for price in prices}))
    columns = tuple(dict.fromkeys(price.series for price in prices))
    exact = _exact(section, table, columns)
    unit = float(np.std([price.price for price in prices])) if normal else 1.0
    form = HistoryModel(
        kind,
        2 if kind == "multi-factor" else 1,
        normal,
        shift,
        table.season,
        quoted=any(price.years > 0 for price in prices),
        columns=columns,
        exact=exact,
        unit=unit,
    )
    _check_amount(section, form, days, prices)
    _check_exact(form, prices)
    history = _history(form, prices, days, table.step)
    notes = tuple(section.notes)
    return Calibration(section.file, title, days, len(prices), form, history, notes)


def _prices(section: TableContext, table: HistoryTable) -> Iterator[ObservedPrice]:
    """All prices of all files; an empty cell is a missing price."""
    if table.spot is not None:
        rows = read_rows(_file(section, "spot", table.spot), ("date", "price"))
        for day, row in zip(rising_dates(rows), rows):
            yield from _observed(row, "price", "spot", day, day)
    if table.maturities is not None:
        rows = read_rows(_file(section, "maturities", table.maturities), ("date",))
        months = _months(rows[0])
        for day, row in zip(rising_dates(rows), rows):
            for column, ahead in months.items():
                yield from _observed(row, column, column, day, ahead / 12)
    if table.quotes is not None:
        columns = ("date", "product", "price")
        rows = read_rows(_file(section, "quotes", table.quotes), columns)
        visited: set[tuple[datetime.date, datetime.date, datetime.date]] = set()
        for row in rows:
            first, last = _product(row)
            day = row.day("date")
            if (day, first, last) in visited:
                raise row.error(
                    "product", f"an earlier row already has the price of this product on {day}"
                )
            visited.add((day, first, last))
            if first < day:
                message = f"its delivery begins on {first}, before the date of the price"
                raise row.error("product", message)
            yield from _observed(row, "price", "quotes", day, first + (last - first) / 2)


def _file(section: TableContext, key: str, name: str) -> FileReference:
    """A file of prices; a calibration is never copied."""
    return FileReference(section, key, name, below=True)


def _months(row: Row) -> dict[str, int]:
    """{column: months to delivery} of a table of constant maturities."""
    months = {}
    for column in row.cells:
        if column == "date":
            continue
        match = MONTHS.fullmatch(column)
        if match is None or int(match[1]) > LATEST:
            message = "a column must be named by its months to delivery, such as 1, F5 or month 13"
            raise CaseError(row.file, "header", column, message)
        months[column] = int(match[1])
    if not months:
        message = "there is no column of prices; name it by its months to delivery, such as F5"
        raise CaseError(row.file, "header", "date", message)
    return months


def _product(row: Row) -> tuple[datetime.date, datetime.date]:
    first, last = delivery_of(row)
    if (last - first).days >= LONGEST:
        message = f"it must be a product of at most {LONGEST} days"
        raise row.error("product", message)
    return first, last


def _observed(
    row: Row, column: str, series: str, day: datetime.date, ahead: float | datetime.date
) -> Iterator[ObservedPrice]:
    """The price of a cell, for delivery `ahead`: after a number of years, or on a day; nothing for
    an empty cell."""
    if row.cells[column] == "":
        return
    yield observed_price(day, series, ahead, row.number(column))._replace(row=row, column=column)


def observed_price(
    day: datetime.date, series: str, ahead: float | datetime.date, price: float
) -> ObservedPrice:
    """A price for delivery after a number of years, or on a day."""
    years = (ahead - day).days / YEAR if isinstance(ahead, datetime.date) else ahead
    length = 366 if calendar.isleap(day.year) else 365
    start = (day.timetuple().tm_yday - 1) / length
    return ObservedPrice(day, series, years, (start + years) % 1.0, price)


def _check_sign(prices: Sequence[ObservedPrice], shift: float) -> None:
    for price in prices:
        if price.price + shift <= 0:
            message = f"it must be a number above {-shift:g}, because the model uses its logarithm"
            if not shift:
                message += '; kind = "one-factor-normal" allows prices of any sign'
            raise price.error(message)


def _exact(section: TableContext, table: HistoryTable, columns: tuple[str, ...]):
    if table.exact is None:
        return tuple(name for name in columns if name == "spot")
    names = tuple(name.lower() for name in table.exact)
    for name in names:
        if name not in columns:
            message = f"there is no such series; {nearest(name, columns, 'series')}"
            raise section.error("exact", name, message)
    return names


def _check_amount(section: TableContext, model: HistoryModel, days, prices) -> None:
    if len(days) < FEWEST or len(prices) < 2 * len(model.names):
        message = (
            f"there are {len(prices)} prices on {len(days)} dates; {len(model.names)} parameters "
            f"need at least {FEWEST} dates and {2 * len(model.names)} prices"
        )
        series = prices[0].series  # the name of its key, or a column of maturities
        key = series if series in ("spot", "quotes") else "maturities"
        raise section.error(key, None, message)


def _check_exact(model: HistoryModel, prices: Sequence[ObservedPrice]) -> None:
    """Refuses exact series if a date has more exact prices than the model has factors, or two with
    the same delivery."""
    count: dict[datetime.date, set[float]] = {}
    for price in prices:
        if price.series not in model.exact:
            continue
        times = count.setdefault(price.day, set())
        if price.years in times or len(times) == model.factors:
            message = (
                f"{price.series} is exact, and a model of {model.factors} factor"
                f"{'s' if model.factors > 1 else ''} cannot match more prices of {price.day} "
                "exactly; leave it out of history.exact"
            )
            raise price.error(message)
        times.add(price.years)


def _history(
    model: HistoryModel,
    prices: Sequence[ObservedPrice],
    days: Sequence[datetime.date],
    step: float | None,
) -> History:
    """The prices by date, with as many columns as the largest number of prices on a date."""
    index = {day: i for i, day in enumerate(days)}
    rows: list[list[ObservedPrice]] = [[] for _ in days]
    for price in prices:
        rows[index[price.day]].append(price)
    shape = len(days), max(map(len, rows))
    value, years, phase = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    present, column = np.zeros(shape, bool), np.zeros(shape, np.int64)
    for i, row in enumerate(rows):
        for j, price in enumerate(row):
            value[i, j] = model.state_of(price.price)
            years[i, j], phase[i, j], present[i, j] = price.years, price.phase, True
            column[i, j] = model.columns.index(price.series)
    elapsed = np.array([(day - days[0]).days / YEAR for day in days])
    gap = np.diff(elapsed, prepend=0.0) if step is None else np.full(len(days), step)
    gap[0] = 0.0
    return History(gap, value, present, years, phase, column, np.asarray(value[0, 0]))  # pyright: ignore


FORMATS = {"": CalibrationTable, "history": HistoryTable, "model": GaussianTable}
