"""The dialect of a CSV: separator, decimal mark, and order of day and month.

Spreadsheets on the European continent write semicolons, decimal commas and 31.12.2024. Such a file
is read if it is unambiguous, and the case gets a note; a file with two possible meanings is
refused. Next to `1,5`, the number `1.234` is 1234; without another number, `1,234` could be 1.234
or 1234.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
COMMA = re.compile(r"[+-]?(\d+|\d{1,3}(\.\d{3})+)?,\d+([eE][+-]?\d+)?", re.ASCII)
POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?", re.ASCII)
THOUSANDS = re.compile(r"[+-]?\d{1,3}([.,]\d{3})+", re.ASCII)
DAY = re.compile(r"(\d{1,2})([./])(\d{1,2})\2(\d{4})", re.ASCII)
MONTH = re.compile(r"(\d{1,2})/(\d{4})", re.ASCII)  # 04.2021 is a number as well
MIDNIGHT = re.compile(r"[T ]00:00(:00(\.0+)?)?$", re.ASCII)

Order = Literal["day", "month"]


class AmbiguousFormat(ValueError):
    """A file with two possible meanings: the ambiguous cell, and the remedy."""

    def __init__(self, cell: str, remedy: str):
        super().__init__(remedy)
        self.cell = cell


@dataclass(frozen=True)
class Dialect:
    """`separator`: of columns; `comma`: whether the decimal mark is a comma; `first`: "day" or
    "month", whichever comes first in 01/02/2024, or None if the file does not show it."""

    separator: str = ","
    comma: bool = False
    first: Order | None = None

    def number(self, cell: str) -> str:
        """A cell's text with a decimal point, if it is a number with a decimal comma."""
        if not self.comma:
            return cell
        if COMMA.fullmatch(cell) or THOUSANDS.fullmatch(cell):
            return cell.replace(".", "").replace(",", ".")
        return cell

    def period(self, cell: str) -> str:
        """A day or month in another form, rewritten as YYYY-MM-DD or YYYY-MM; any other cell is
        unchanged.

        **Raises:** `AmbiguousFormat` for a date such as 01/02/2024 if no date of the file shows
        whether day or month comes first.
        """
        cell = MIDNIGHT.sub("", cell)
        if match := MONTH.fullmatch(cell):
            return f"{match[2]}-{int(match[1]):02}"
        if not (match := DAY.fullmatch(cell)):
            return cell
        one, mark, two, year = match.groups()
        first = "day" if mark == "." else self.first
        if first is None:
            raise AmbiguousFormat(cell, "day and month are ambiguous; a date is written YYYY-MM-DD")
        day, month = (one, two) if first == "day" else (two, one)
        return f"{year}-{int(month):02}-{int(day):02}"

    def describe(self) -> str:
        """The differences from a CSV with commas between columns and decimal points, for a note; ""
        if there are none."""
        messages = []
        if self.separator != ",":
            messages.append(f"{SEPARATORS[self.separator]} between the columns")
        if self.comma:
            messages.append("commas as decimal marks")
        if self.first is not None:
            messages.append("days before months" if self.first == "day" else "months before days")
        return ", ".join(messages)


def separator(header: str) -> str:
    """The separator of a header row: the most frequent one, else the comma."""
    bare = re.sub(r'"[^"]*"', "", header)
    return max(SEPARATORS, key=lambda item: bare.count(item))


def dialect(header: str, rows: Iterable[Sequence[str]]) -> Dialect:
    """The dialect of a file, from its header row and all cells below it.

    **Raises:** `AmbiguousFormat` if the cells contradict each other or have two possible meanings.
    """
    mark, cells = separator(header), {cell for row in rows for cell in row}
    comma = mark != "," and _decimal_comma(cells)
    return Dialect(mark, comma, _first(cells))


def _decimal_comma(cells: set[str]) -> bool:
    """Whether numbers have a decimal comma; a file with both decimal commas and decimal points is
    refused."""
    doubtful = sorted(cell for cell in cells if THOUSANDS.fullmatch(cell))
    commas = sorted(c for c in cells if COMMA.fullmatch(c) and c not in doubtful)
    points = sorted(c for c in cells if POINT.fullmatch(c) and c not in doubtful)
    if commas and points:
        message = f"this number has a decimal comma and {points[0]} a point; use one of them"
        raise AmbiguousFormat(commas[0], message)
    if doubtful and not commas and not points:
        raise AmbiguousFormat(
            doubtful[0], "this mark may separate decimals or thousands; write 1.5 or 1234"
        )
    return bool(commas)


def _first(cells: set[str]) -> Order | None:
    """Whether day or month comes first in dates with slashes, which any number above twelve
    shows."""
    table: dict[Order, str] = {}
    for cell in sorted(cells):
        match = DAY.fullmatch(MIDNIGHT.sub("", cell))
        if not match or match[2] != "/":
            continue
        if int(match[1]) > 12:
            table["day"] = cell
        if int(match[3]) > 12:
            table["month"] = cell
    if len(table) == 2:
        message = (
            f"here the month comes first, but in {table['day']} the day comes first; write "
            "YYYY-MM-DD"
        )
        raise AmbiguousFormat(table["month"], message)
    return next(iter(table), None)
