"""The delivery days of traded products by their names."""

import datetime
import re
from collections.abc import Callable

from snapo.case.csv import Row

ONE = datetime.timedelta(1)
FIRST, LAST = 1900, 2199  # years with products
NAMES = (
    "a day (2026-01-15), a weekend ('weekend 2026-01-17'), a month (2026-01), a quarter (2026-Q1), "
    "a season ('summer 2026' or 'winter 2026'), a gas year from October ('gas year 2026'), a year "
    "(2026), or a first and a last day (2026-01-15/2026-01-31)"
)


def months(year: int, month: int, count: int) -> tuple[datetime.date, datetime.date]:
    """The first and the last day of a number of consecutive months."""
    after = year * 12 + month - 1 + count
    return datetime.date(year, month, 1), datetime.date(after // 12, after % 12 + 1, 1) - ONE


def _weekend(year: str, month: str, day: str) -> tuple[datetime.date, datetime.date]:
    saturday = datetime.date(int(year), int(month), int(day))
    return saturday, saturday + ONE


def _days(first: str, last: str) -> tuple[datetime.date, datetime.date]:
    return datetime.date.fromisoformat(first), datetime.date.fromisoformat(last)


DATE = r"(\d{4})-(\d{2})-(\d{2})"
ISO = r"(\d{4}-\d{2}-\d{2})"
PATTERNS: dict[str, Callable[..., tuple[datetime.date, datetime.date]]] = {
    ISO: lambda day: _days(day, day),
    rf"{ISO}/{ISO}": _days,
    rf"weekend {DATE}": _weekend,
    r"(\d{4})-(\d{2})": lambda year, month: months(int(year), int(month), 1),
    r"(\d{4})-Q([1-4])": lambda year, quarter: months(int(year), 3 * int(quarter) - 2, 3),
    r"summer (\d{4})": lambda year: months(int(year), 4, 6),
    r"winter (\d{4})": lambda year: months(int(year), 10, 6),
    r"gas year (\d{4})": lambda year: months(int(year), 10, 12),
    r"(\d{4})": lambda year: months(int(year), 1, 12),
}


def delivery(name: str) -> tuple[datetime.date, datetime.date]:
    """The first and the last day of a product, both included; upper and lower case are not
    distinguished.

    **Raises:** `ValueError` if there is no such product, or no such day.

    >>> delivery("winter 2026")
    (datetime.date(2026, 10, 1), datetime.date(2027, 3, 31))
    """
    for pattern, days in PATTERNS.items():
        if match := re.fullmatch(pattern, " ".join(name.split()), re.ASCII | re.IGNORECASE):
            try:
                first, last = days(*match.groups())
            except (ValueError, OverflowError):
                raise ValueError("there is no such day or month in the calendar") from None
            if pattern.startswith("weekend") and first.weekday() != 5:
                raise ValueError(f"{first} is not a Saturday")
            if last < first:
                raise ValueError("the last day is before the first day")
            if first.year < FIRST or last.year > LAST:
                raise ValueError(f"its days must be in the years {FIRST} to {LAST}")
            return first, last
    raise ValueError(f"a product is {NAMES}")


def delivery_of(row: Row) -> tuple[datetime.date, datetime.date]:
    """The first and the last day of the product of a row, written as its table writes dates.

    **Raises:** `CaseError` if there is no such product.
    """
    try:
        return delivery(row.label("product"))
    except ValueError as error:
        raise row.error("product", str(error)) from None
