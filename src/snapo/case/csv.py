"""Reads the CSV files and arrays of a case; the message of every mistake names the line and the
remedy.

A CSV is UTF-8 (with or without a byte-order mark), with a header row that names the columns in any
order; blank lines and lines that start with `#` are ignored. Commas separate the columns, numbers
have a decimal point, days are YYYY-MM-DD and months are YYYY-MM; see `dialect` for other formats.
"""

import csv
import datetime
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .dialect import AmbiguousFormat, Dialect, dialect, separator
from .error import CaseError, Unquoted, nearest
from .given import SheetCell
from .table import LARGEST, TOO_LARGE, Range, TableContext, not_utf8

PARQUET = "Parquet needs the package pyarrow: pip install 'snapo[parquet]'"
FRAMES = "data frames need the package narwhals: pip install 'snapo[frames]'"


def parquet_lines(reference: "FileReference", path: Path) -> list[tuple[int, list[str]]]:
    """The rows of a Parquet file as (line number, cells); as in a CSV, the first row has the column
    names.

    **Raises:** `CaseError` if pyarrow is missing, or the file is damaged or nested.
    """
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise reference.error(f"{PARQUET}; or use a CSV file") from None
    try:
        table = parquet.read_table(path)
        columns = [column.to_pylist() for column in table.columns]
    except Exception as error:  # of Arrow, whatever is wrong with the file
        message = f"this is not a Parquet file ({str(error).strip().splitlines()[0]})"
        raise CaseError(reference.name, "", None, message) from None
    return list(enumerate(_lines(table.column_names, zip(*columns)), start=1))


def _lines(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Iterable[list[str]]:
    yield [str(name).strip() for name in names]
    for row in rows:
        yield [cell(value) for value in row]


def cell(value: Any) -> str:
    """The text of a value in a CSV of a case; "" for no value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, datetime.datetime):
        day = value.time() == datetime.time() and value.tzinfo is None
        return value.date().isoformat() if day else value.isoformat(" ")
    if isinstance(value, datetime.date):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value).strip()


def write_table(frame: Any, file: Path | str) -> Path:
    """Writes a data frame (pandas, polars, pyarrow …) as a file that a case can name.

    The file's suffix determines the format: `.csv` or `.parquet`. Column names are those of the
    frame; an index is omitted. Returns the path.

    **Raises:** `ModuleNotFoundError` if narwhals or pyarrow is missing, `ValueError` for another
    suffix, `TypeError` for an object that is not a frame.

    >>> snapo.write_table({"month": ["2025-01"]}, "curve.csv")
    Traceback (most recent call last):
    TypeError: write_table: a dict is not a data frame; use one of pandas, polars or pyarrow.
    """
    try:
        import narwhals as nw
    except ModuleNotFoundError:
        raise ModuleNotFoundError(f"write_table: {FRAMES}") from None
    file = Path(file)
    try:
        table = nw.from_native(frame, eager_only=True)
    except TypeError:
        message = (
            f"a {type(frame).__name__} is not a data frame; use one of pandas, polars or pyarrow."
        )
        raise TypeError(f"write_table: {message}") from None
    match file.suffix.lower():
        case ".csv":
            with file.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerows(_lines(table.columns, table.iter_rows()))
        case ".parquet":
            try:
                import pyarrow.parquet as parquet
            except ImportError:
                raise ModuleNotFoundError(f"write_table: {PARQUET}") from None
            parquet.write_table(table.to_arrow(), file)
        case other:
            raise ValueError(
                f"write_table: the name of the file ends in {other!r}; it must end "
                "in .csv or .parquet."
            )
    return file


DAY = re.compile(r"\d{4}-\d{2}-\d{2}", re.ASCII)
MONTH = re.compile(r"(\d{4})-(\d{2})", re.ASCII)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class FileReference:
    """A reference of a case to a file: the table, the key, and the name.

    `below`: whether the file may be in a folder below the folder of the case. This is right only if
    no copy of the case is ever made, as runs hash and copy the files next to a case only.
    """

    section: TableContext
    key: str
    name: str
    below: bool = False

    def error(self, allowed: str) -> CaseError:
        """A mistake in the name itself."""
        return self.section.error(self.key, self.name, allowed)


@dataclass(frozen=True)
class Row:
    """One line of a CSV: its file, its line number from 1, its cells by column, and its dialect."""

    file: str
    line: int
    cells: dict[str, str]
    dialect: Dialect = Dialect()

    def error(self, column: str, allowed: str) -> CaseError:
        """A mistake in one cell of this line."""
        value = self.cells[column]
        displayed = value if value else Unquoted("an empty cell")
        return CaseError(self.file, f"line {self.line}, column {column}", displayed, allowed)

    def number(
        self, column: str, low: float = -math.inf, high: float = math.inf, allowed: str = ""
    ) -> float:
        """A finite number within [low, high]; `allowed`: the allowed numbers as text."""
        text, noun = self.cells[column], "a finite number" if low == -high == -math.inf else ""
        allowed = allowed or str(Range(low, high, noun=noun))
        value = float(text) if NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(value):
            raise self.error(column, f"it must be {allowed}, written like 12.5")
        if not low <= value <= high:
            raise self.error(column, f"it must be {allowed}")
        if abs(value) > LARGEST:
            raise self.error(column, f"it must be {allowed}; {TOO_LARGE}")
        return value

    def position(self, column: str) -> SheetCell:
        """The position of one cell of this line."""
        return SheetCell(self.file, self.line, column)

    def day(self, column: str) -> datetime.date:
        """A day that exists, YYYY-MM-DD."""
        period = self.period(column)
        if not isinstance(period, datetime.date):
            raise self.error(column, "a date is written YYYY-MM-DD")
        return period

    def month(self, column: str) -> tuple[int, int]:
        """A month, YYYY-MM, as (year, month)."""
        period = self.period(column)
        if not isinstance(period, tuple):
            raise self.error(column, "a month is written YYYY-MM")
        return period

    def period(self, column: str) -> datetime.date | tuple[int, int] | None:
        """An existing day, or a month as (year, month); None for any other text."""
        try:
            text = self.dialect.period(self.cells[column])
            if DAY.fullmatch(text):
                return datetime.date.fromisoformat(text)
        except AmbiguousFormat as doubt:
            raise self.error(column, str(doubt)) from None
        except ValueError:
            raise self.error(column, "there is no such day in the calendar") from None
        if not (match := MONTH.fullmatch(text)):
            return None
        if not 1 <= int(match[2]) <= 12 or match[1] == "0000":
            raise self.error(column, "there is no such month in the calendar")
        return int(match[1]), int(match[2])

    def label(self, column: str) -> str:
        """The text of a cell; an unambiguous day or month is written YYYY-MM-DD or YYYY-MM."""
        try:
            return self.dialect.period(self.cells[column])
        except AmbiguousFormat:
            return self.cells[column]


def ordinals(days: Sequence[datetime.date]) -> np.ndarray:
    """[n] proleptic Gregorian day numbers, int64."""
    return np.array([day.toordinal() for day in days], np.int64)


def rising_dates(rows: Sequence[Row], column: str = "date") -> list[datetime.date]:
    """The dates of all rows, which must increase."""
    dates: list[datetime.date] = []
    for row in rows:
        date = row.day(column)
        if dates and date <= dates[-1]:
            message = f"dates must increase; the previous row has {dates[-1].isoformat()}"
            raise row.error(column, message)
        dates.append(date)
    return dates


def file_in_folder(reference: FileReference, suffixes: Sequence[str]) -> Path:
    """The plain file that a case names, which must be in the folder of the case."""
    name = Path(reference.name)
    kinds = " or ".join(suffixes)
    if name.suffix.lower() not in suffixes:
        raise reference.error(f"it must be the name of a {kinds} file in the folder of the case")
    folder = reference.section.file.parent.resolve()
    path = folder / name
    try:
        inside, exists = path.resolve().is_relative_to(folder), path.exists()
    except (OSError, ValueError, RuntimeError) as error:  # the last: links in a circle
        raise reference.error(f"this cannot be the name of a file ({error.args[-1]})") from None
    if name.is_absolute() or not inside:
        raise reference.error("a file that a case names must be in the folder of the case")
    if len(name.parts) > 1 and not reference.below:
        message = "a file that a case names must be in the folder of the case, not below it"
        raise reference.error(f"{message}; move the file there and write {name.name!r}")
    if not exists:
        present = [file.name for file in sorted(folder.iterdir()) if file.suffix in suffixes]
        hint = f" (there are {', '.join(present)})" if present else ""
        raise reference.error(f"there is no such file in {folder}{hint}")
    if not path.is_file():
        raise reference.error("this is not a plain file")
    return path


def read_rows(
    reference: FileReference,
    columns: Sequence[str],
    optional: Sequence[str] | None = None,
    with_keys: bool = False,
) -> list[Row]:
    """Reads the CSV that a case names; every row has all `columns`, and blanks around its cells are
    removed. A Parquet file is read like the CSV of the same table. The only other columns allowed
    are `optional`, so that a misspelt column is not taken for an omitted one; with None any column
    is allowed. Names of columns are converted to lower case; with `with_keys`, names with a point
    are keys of a case and stay unchanged.
    """
    path = file_in_folder(reference, (".csv", ".parquet"))
    name = reference.name
    if path.suffix.lower() == ".parquet":
        result, written = parquet_lines(reference, path), Dialect()
    else:
        result, written = _read(reference, _text(path, name))
    if not result:
        message = f"the file is empty; its first line must be {','.join(columns)}"
        raise CaseError(name, "", None, message)
    (line, cells), *records = result
    names = _header(name, line, cells, columns, with_keys)
    available = names if optional is None else (*columns, *optional)
    for column in names:
        if column not in available:
            message = f"there is no such column; {nearest(column, available, 'column')}"
            raise CaseError(name, f"line {line}", column, message)
    rows = []
    for line, cells in records:
        if len(cells) != len(names):
            got = Unquoted(f"{len(cells)} cells")
            message = (
                f"the row must have as many cells as the header, {len(names)} "
                f"({','.join(names)}); decimals are written with a point"
            )
            raise CaseError(name, f"line {line}", got, message)
        numbers = map(written.number, cells)
        rows.append(Row(name, line, dict(zip(names, numbers, strict=True)), written))
    if not rows:
        raise CaseError(name, "", None, "there are no rows below the header")
    return rows


def _text(path: Path, name: str) -> str:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(name, "", None, not_utf8(error)) from None
    except OSError as error:
        raise CaseError(name, "", None, f"the file cannot be read ({error.strerror})") from None
    if "\0" in text:
        message = (
            "the file contains zero bytes, probably because it is in UTF-16; save it as CSV "
            "in UTF-8"
        )
        raise CaseError(name, "", None, message)
    return text


def _read(reference: FileReference, text: str) -> tuple[list[tuple[int, list[str]]], Dialect]:
    """Line numbers and cells, with the header first, and the dialect, which a note to the case
    describes."""
    lines = (line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    header = next(lines, "")
    records = list(_records(reference.name, text, separator(header)))
    try:
        written = dialect(header, (cells for _, cells in records[1:]))
    except AmbiguousFormat as doubt:
        line, cells = next(item for item in records[1:] if doubt.cell in item[1])
        names = [*records[0][1], *cells]  # a line may have too many cells
        where = f"line {line}, column {names[cells.index(doubt.cell)]}"
        raise CaseError(reference.name, where, doubt.cell, str(doubt)) from None
    if written.describe():
        reference.section.notes.append(f"{reference.name} was read with {written.describe()}.")
    return records, written


def _records(name: str, text: str, separated_by: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each line that is neither blank nor a comment."""
    reader = csv.reader(text.splitlines(), strict=True, delimiter=separated_by)
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if any(cells) and not cells[0].startswith("#"):
                yield reader.line_num, cells
    except csv.Error as error:
        raise CaseError(name, f"line {reader.line_num}", None, f"not a CSV line: {error}") from None


def _header(
    name: str, line: int, cells: list[str], columns: Sequence[str], with_keys: bool
) -> list[str]:
    names = [cell if with_keys and "." in cell else cell.lower() for cell in cells]
    requested = ",".join(columns)
    for column in columns:
        if column in names:
            continue
        got = Unquoted(f"the header {','.join(cells)!r}")
        message = f"column {column} is missing; the header is {requested}"
        raise CaseError(name, f"line {line}", got, message)
    for column in names:
        if column and names.count(column) > 1:
            raise CaseError(name, f"line {line}", column, "this column appears twice")
    return names


def read_array(reference: FileReference, columns: int, meaning: str) -> np.ndarray:
    """Reads a finite float64 array [path, day] from .npy (no pickles) or Parquet."""
    path = file_in_folder(reference, (".npy", ".parquet"))
    array = _npy(reference, path) if path.suffix.lower() == ".npy" else _parquet(reference, path)
    if array.ndim != 2 or array.shape[1] != columns or array.shape[0] < 2:
        got = Unquoted(f"an array of shape {array.shape}")
        message = f"it must be [path, day] with 2 paths or more and {columns} columns, {meaning}"
        raise CaseError(reference.name, "", got, message)
    if array.dtype.kind not in "fiu":
        got = Unquoted(f"numbers of type {array.dtype}")
        raise CaseError(reference.name, "", got, "it must be real numbers")
    invalid = np.argwhere(~np.isfinite(array))
    if len(invalid):
        row, column = invalid[0]
        where = f"path {row}, day {column} (both from 0)"
        raise CaseError(reference.name, where, array[row, column], "every price must be finite")
    return array.astype(np.float64)


def _npy(reference: FileReference, path: Path) -> np.ndarray:
    try:
        with path.open("rb") as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as error:  # a damaged header can be a size, a type or a syntax as well
        message = f"this is not a .npy file of plain numbers ({_first_line(error)})"
        raise CaseError(reference.name, "", None, message) from None


def _first_line(error: Exception) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__


def _parquet(reference: FileReference, path: Path) -> np.ndarray:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise reference.error(f"{PARQUET}; or use .npy") from None
    try:
        table = parquet.read_table(path)
        return np.column_stack([column.to_numpy() for column in table.columns])
    except Exception as error:  # of Arrow, or of columns that are no numbers
        message = f"this is not a Parquet file of plain numbers ({_first_line(error)})"
        raise CaseError(reference.name, "", None, message) from None
