"""Tables and bar charts of records; the type of a value determines its format.

Texts are aligned to the left, and numbers to the right with as many decimals as their column needs.
A number with a standard error has its half-width next to it, and a boolean is a mark.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from . import charts
from .drawing import draw
from .page import Chart, Mark, Table
from .quantity import decimals, measured, number


class WithError(NamedTuple):
    """A number and its standard error (None if it has none), from which half of the 95 % interval
    is written after ±."""

    value: float | None
    error: float | None = None


class Column(NamedTuple):
    """A column of a table of records.

    - `of`: the name of an attribute, or a function of the record; `unit`: the unit in the header.
      - `digits`: significant digits of the largest number; `sign`: whether a plus sign is written.
      - `decimal_places`: the number of decimals; None if `digits` determines it.
    """

    name: str
    of: str | Callable[[Any], Any]
    unit: str = ""
    digits: int = 5
    sign: bool = False
    decimal_places: int | None = None

    def values(self, records: Sequence[Any]) -> list[Any]:
        """The values of the column for all records."""
        of = self.of
        return [of(record) if callable(of) else getattr(record, of) for record in records]

    def cells(self, values: Sequence[Any], by_row: Sequence[int] | None) -> list[tuple[Any, ...]]:
        """The cells of each row: two cells for a number with an error, else one. `by_row`: the
        decimals of each row; None means those of the column.
        """
        if all(isinstance(x, str) for x in values):
            return [(x,) for x in values]
        if all(isinstance(x, bool) for x in values):
            return [(Mark(x, "holds" if x else "fails"),) for x in values]
        pairs = [x if isinstance(x, WithError) else WithError(x) for x in values]
        if by_row is None:
            digits = decimals([x.value for x in pairs], self.digits)
            by_row = [digits if self.decimal_places is None else self.decimal_places] * len(pairs)
        if any(isinstance(x, WithError) for x in values):
            return [measured(*x, n, sign=self.sign) for x, n in zip(pairs, by_row)]
        return [(number(x.value, n, self.sign),) for x, n in zip(pairs, by_row)]


def table(
    records: Sequence[Any],
    columns: Sequence[Column],
    caption: str = "",
    *,
    folded: str = "",
    decimal_places: int | None = None,
    by_row: bool = False,
) -> Table:
    """A table with a row for each record.

    - `decimal_places`: the decimals of all numbers; `by_row`: whether decimals differ between rows.
      - `folded`: the text to click on to show the table.
    """
    values = [column.values(records) for column in columns]
    all_places = None if decimal_places is None else [decimal_places] * len(records)
    if by_row:
        all_places = [decimals(_numbers(row)) for row in zip(*values)]
    head, texts, cells = [], set(), []
    for column, column_values in zip(columns, values):
        column_cells = column.cells(column_values, all_places)
        if all(isinstance(x, str) for x in column_values):
            texts.add(len(head))
        head += [(column.name, column.unit), ("", "")][: len(column_cells[0])]
        cells.append(column_cells)
    rows = [sum(row, ()) for row in zip(*cells)]
    return Table(head, rows, caption, frozenset(texts), folded=folded)


def _numbers(row: Sequence[Any]) -> list[Any]:
    return [x.value if isinstance(x, WithError) else x for x in row if not isinstance(x, str)]


class Bar(NamedTuple):
    """A bar of a ladder chart; `strong`: whether it is emphasised."""

    name: str
    value: float
    error: float | None = None
    strong: bool = False


def ladder(anchor: str, bars: Sequence[Bar], caption: str, digits: int | None = None) -> Chart:
    """A ladder chart: horizontal bars with their numbers, the first on top, and a description of
    them."""
    digits = decimals([bar.value for bar in bars], 5) if digits is None else digits
    rows = [
        charts.LadderBar(bar.name, bar.value, number(bar.value, digits), bar.error, bar.strong)
        for bar in bars
    ]
    alt = "; ".join(f"{bar.name} {bar.text}" for bar in rows)
    svg = draw(anchor, alt, lambda axes: charts.ladder(axes, rows), 40 + 34 * len(rows))
    return Chart(svg, caption)
