"""Results as tables: CSV files, data frames, HTML for notebooks, and workbooks."""

import datetime
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.problem.carry.arrays import replacing

# Files of a solution.
POLICY, HALFWAY, SOLUTION = "policy.npz", "halfway.npz", "solution.npz"
SENSITIVITIES, VERDICTS = "sensitivities.csv", "verdicts.csv"
HISTORY, RESULT, GROWTH = "history.csv", "result.json", "adjoints.csv"


def write_csv(
    file: Path, header: Iterable[str], rows: Iterable[Iterable[Any]], *, shared: bool = False
) -> None:
    """A table with a header; numbers keep all their digits. `shared` as in `write_text`."""

    def lines() -> Iterable[str]:
        yield ",".join(header)
        for row in rows:
            yield ",".join(_csv_cell(value) for value in row)

    write_text(file, "\n".join(lines()) + "\n", shared=shared)


def _csv_cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return repr(float(value))
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text


def write_text(file: Path, text: str, *, shared: bool = False) -> None:
    """Writes a file atomically. `shared`: whether other processes may write it at the same time."""
    with replacing(file, shared) as partial:
        partial.write_text(text, encoding="utf-8")


BACKENDS = ("pandas", "polars", "pyarrow")


def frame(columns: Mapping[str, Any], backend: str = "pandas") -> Any:
    """A data frame with these columns; a table of Arrow for "pyarrow".

    **Raises:** `ValueError` for another backend, `ModuleNotFoundError` if it is not installed.
    """
    try:
        match backend:
            case "pandas":
                import pandas

                return pandas.DataFrame(dict(columns))
            case "polars":
                import polars

                return polars.DataFrame(dict(columns))
            case "pyarrow":
                import pyarrow

                return pyarrow.table(dict(columns))
    except ModuleNotFoundError:
        message = f"frame: {backend} is not installed: pip install {backend}"
        raise ModuleNotFoundError(message) from None
    raise ValueError(f"frame: the backend is {backend!r}; it must be one of {', '.join(BACKENDS)}.")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], text: Sequence[int] = (0,)) -> str:
    """A table of texts; columns not in `text` are numbers, aligned to the right."""

    def cells(tag: str, row: Sequence[str]) -> str:
        sides = ("left" if i in text else "right" for i in range(len(row)))
        return "".join(
            f'<{tag} style="text-align:{side}">{escape(cell)}</{tag}>'
            for side, cell in zip(sides, row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{cells('th', head)}</tr></thead><tbody>{body}</tbody></table>"


def paragraph(text: str) -> str:
    """A line of text."""
    return f"<p>{escape(text)}</p>"


NEEDED = "workbooks need the package openpyxl: pip install 'snapo[xlsx]'"
MAX_ROWS, MAX_NAME = 1_000_000, 31  # of a sheet; letters of its name
DAY = re.compile(r"\d{4}-\d\d-\d\d")


class Picture(NamedTuple):
    """A chart next to a table: `y` columns against the column `x`, by their names."""

    kind: Literal["line", "bar"]
    x: str
    y: Sequence[str]


class SheetTable(NamedTuple):
    """A table and, optionally, its chart."""

    header: Sequence[str]
    rows: Iterable[Sequence[Any]]
    picture: Picture | None = None


def write_tables(file: Path, tables: Mapping[str, SheetTable]) -> None:
    """Writes a sheet for each table. Text is never written as a formula.

    **Raises:** `ModuleNotFoundError` if openpyxl is missing.
    """
    try:
        from openpyxl import Workbook
        from openpyxl.styles import Font
    except ModuleNotFoundError:
        raise ModuleNotFoundError(NEEDED) from None
    book = Workbook()
    book.remove(book.worksheets[0])
    for name, table in tables.items():
        sheet = book.create_sheet(re.sub(r"[\[\]:*?/\\']", " ", name)[:MAX_NAME])
        columns = _fill(sheet, table)
        for cell in sheet[1]:
            cell.font = Font(bold=True)
        sheet.freeze_panes = "A2"
        if table.picture is not None and sheet.max_row > 1:
            _draw(sheet, table, columns)
    book.save(file)


def _fill(sheet: Any, table: SheetTable) -> int:
    """Writes header and rows; returns the number of columns."""
    from openpyxl.utils import get_column_letter

    largest: dict[int, float] = {}
    for i, row in enumerate([table.header, *table.rows][: MAX_ROWS + 1], 1):
        for j, value in enumerate(map(_native, row), 1):
            if value is None:
                continue
            cell = sheet.cell(i, j, value)
            if isinstance(value, str):
                cell.data_type = "s"  # never a formula
            elif isinstance(value, datetime.date):
                cell.number_format = "yyyy-mm-dd"
            elif i > 1 and not isinstance(value, bool):
                largest[j] = max(largest.get(j, 0.0), abs(value))
    for j, size in largest.items():
        for (cell,) in sheet.iter_rows(2, None, j, j):
            if isinstance(cell.value, float):
                cell.number_format = _format(size)
    for j, name in enumerate(table.header, 1):
        sheet.column_dimensions[get_column_letter(j)].width = max(12, min(40, len(str(name)) + 4))
    return len(table.header)


def _native(value: Any) -> Any:
    """A value as a cell contains it; empty for a number that is not finite."""
    if value is None or isinstance(value, bool | int | datetime.date):
        return value
    if isinstance(value, str):
        return datetime.date.fromisoformat(value) if DAY.fullmatch(value) else value
    try:
        number = float(value)
    except (TypeError, ValueError):
        return str(value)
    return number if math.isfinite(number) else None


def _format(largest: float) -> str:
    """The format of a column, by its largest number."""
    if largest >= 1e4:
        return "#,##0"
    if largest >= 10:
        return "#,##0.00"
    return "0.0000" if largest >= 1e-2 else "0.00E+00"


def _draw(sheet: Any, table: SheetTable, columns: int) -> None:
    """The chart, to the right of its table."""
    from openpyxl.chart import BarChart, LineChart, Reference
    from openpyxl.utils import get_column_letter

    picture, names = table.picture, list(table.header)
    assert picture is not None
    chart: Any = LineChart() if picture.kind == "line" else BarChart()
    for name in picture.y:
        column = names.index(name) + 1
        chart.add_data(
            Reference(sheet, min_col=column, min_row=1, max_row=sheet.max_row),
            titles_from_data=True,
        )
    at = names.index(picture.x) + 1
    chart.set_categories(Reference(sheet, min_col=at, min_row=2, max_row=sheet.max_row))
    chart.title, chart.height, chart.width = sheet.title, 9, 18
    chart.x_axis.title, chart.x_axis.delete, chart.y_axis.delete = picture.x, False, False
    sheet.add_chart(chart, f"{get_column_letter(columns + 2)}2")


BINS = 40


TRAINING = Picture("line", "step", ("objective",))


def sensitivities_chart(rows: list[Any]) -> Picture | None:
    """Derivatives by label, or by input if most have no label; None if a chart would be too long.

    `rows`: input, label …
    """
    labelled = sum(bool(row[1]) for row in rows) > len(rows) / 2
    return (
        Picture("bar", "label" if labelled else "input", ("value",)) if len(rows) <= 400 else None
    )


def flat(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested tables, with its path as text."""
    for key, value in table.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{name}, ")
        elif isinstance(value, list | tuple):
            yield name, "; ".join(map(str, value))
        else:
            yield name, value


def histogram(totals: np.ndarray) -> SheetTable:
    """The number of paths with a total between two numbers."""
    values = np.asarray(totals, np.float64)
    counts, edges = np.histogram(values[np.isfinite(values)], BINS)
    rows = list(zip(edges[:-1].tolist(), edges[1:].tolist(), counts.tolist()))
    return SheetTable(("from", "to", "paths"), rows, Picture("bar", "from", ("paths",)))
