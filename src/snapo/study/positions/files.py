"""The files of a case in memory: its tables and the text of every file next to it."""

import csv
import datetime
import io
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import (
    CaseInput,
    ConvertedNumber,
    Copies,
    FilePosition,
    KeyedUnit,
    NoPosition,
    QuantityKey,
    SheetCell,
)
from snapo.case.table import TableContext
from snapo.case.toml import to_toml
from snapo.study.run_folder import case_files, tables_named

Key = tuple[str | int, ...]  # the way to a value in the tables
PlainPosition = SheetCell | QuantityKey | KeyedUnit | Key


class Sheet(NamedTuple):
    """A CSV: its header and its rows as texts, without comments.

    `lines`: the line numbers of the rows in the file that was read, from 1.
    """

    header: list[str]
    rows: list[list[str]]
    lines: list[int]

    def column(self, name: int) -> list[str]:
        return [row[name] for row in self.rows]

    def text(self) -> str:
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.header, *self.rows])
        return out.getvalue()


@dataclass(frozen=True, eq=False)
class Files:
    """The tables of a case, the CSVs that they name, and the folder with all other files."""

    folder: Path
    tables: Mapping[str, Any]
    sheets: Mapping[str, Sheet] = field(default_factory=dict)
    changed: frozenset[str] = frozenset()

    def with_value(self, key: Key, value: Any) -> "Files":
        """The case with a new value at one position in its tables."""
        return replace(self, tables=_put(self.tables, key, value))

    def without(self, names: Sequence[str]) -> "Files":
        """The case without these tables."""
        return replace(self, tables={k: v for k, v in self.tables.items() if k not in names})

    def with_sheet(self, name: str, sheet: Sheet) -> "Files":
        """The case with a new CSV of this name."""
        return replace(self, sheets={**self.sheets, name: sheet}, changed=self.changed | {name})

    def write(self, folder: Path) -> Path:
        """Writes the case to a separate folder, as case.toml and its other files, which replace
        files of the same names; returns case.toml."""
        folder.mkdir(parents=True, exist_ok=True)
        named = tables_named(self.folder, self.tables)
        for case_file in case_files(self.folder, pictures=True):
            apart = case_file.suffix.lower() == ".toml" and case_file not in named
            if not apart and case_file.name not in self.changed:
                shutil.copyfile(case_file, folder / case_file.name)
        for name in self.changed:
            (folder / name).write_text(self.sheets[name].text(), encoding="utf-8")
        file = folder / "case.toml"
        file.write_text(to_toml(self.tables), encoding="utf-8")
        return file


def read_files(folder: Path, tables: Mapping[str, Any]) -> Files:
    """The case whose tables were read from `folder`, with the CSVs that these name, and the CSVs
    whose names are in cells of these CSVs."""
    available = {file.name for file in case_files(folder) if file.suffix.lower() == ".csv"}
    requested = {value for _, value in _leaves(tables, ()) if isinstance(value, str)} & available
    sheets: dict[str, Sheet] = {}
    while new := requested - sheets.keys():
        sheets |= {name: _sheet(folder, name) for name in sorted(new)}
        rows = [row for name in new for row in sheets[name].rows]
        requested |= {cell for row in rows for cell in row if cell in available}
    return Files(folder, tables, sheets)


def _sheet(folder: Path, name: str) -> Sheet:
    """A CSV as a case reads it: with decimal points, and dates YYYY-MM-DD."""
    try:
        rows = read_rows(FileReference(TableContext(folder / "case.toml", "", []), "", name), ())
    except CaseError:  # its reader has other rules
        return Sheet([], [], [])
    header = list(rows[0].cells)
    texts = [[row.label(column) for column in header] for row in rows]
    return Sheet(header, texts, [row.line for row in rows])


def with_numbers(files: Files, entry: CaseInput, numbers: np.ndarray) -> Files:
    """The files of a case with new numbers in the positions of an input. Days that share the line
    of their month continue to share it if their numbers are equal; otherwise every day gets a line.

    **Raises:** `CaseError` for a number that no file has, or whose file is not a CSV.
    """
    if numbers.size != len(entry.positions):
        count = f"{numbers.size} numbers for {len(entry.positions)} positions"
        raise CaseError(entry.name, "", None, f"the case has other labels: {count}")
    changes: dict[PlainPosition, dict[str, float]] = {}
    for i, (position, label) in enumerate(zip(entry.positions, entry.labels)):
        number = float(numbers.ravel()[i])
        if position is None or isinstance(position, NoPosition):
            if number == entry.values[i]:
                continue
            reason = position.reason if position else "this number is in no file of the case"
            raise CaseError(entry.name, label, None, reason)
        for plain, written in _plain(position, number):
            changes.setdefault(plain, {})[label] = written
    for position, by_label in changes.items():
        number = next(iter(by_label.values()))
        if isinstance(position, SheetCell):
            files = files.with_sheet(position.file, _with_cell(files, position, by_label))
        elif isinstance(position, QuantityKey):
            files = files.with_value(position.path, f"{number!r} {position.unit}")
        elif isinstance(position, KeyedUnit):
            for path, unit in position.units:
                files = files.with_value(path, unit)
            files = files.with_value(position.path, number)
        else:
            files = files.with_value(position, number)
    return files


def _plain(position: FilePosition, number: float) -> Iterator[tuple[PlainPosition, float]]:
    """The position at which a number is written, and the number itself."""
    if isinstance(position, ConvertedNumber):
        yield from _plain(position.position, position.inverse(number))
    elif isinstance(position, Copies):
        for copy in position.positions:
            yield from _plain(copy, number)
    elif position is not None and not isinstance(position, NoPosition):
        yield position, number


def readable(entry: CaseInput, numbers: np.ndarray) -> np.ndarray:
    """The numbers that are read after `with_numbers` has written `numbers`. If a case converts a
    number, the result is the nearest one that a float in its files can represent."""
    pairs = zip(entry.positions, numbers.ravel().tolist())
    return np.array(
        [at.read(at.inverse(x)) if isinstance(at, ConvertedNumber) else x for at, x in pairs]
    )


def _with_cell(files: Files, cell: SheetCell, numbers: Mapping[str, float]) -> Sheet:
    """A sheet with a new number in a cell, or with a row for each label if their numbers differ."""
    sheet = files.sheets.get(cell.file)
    if sheet is None or cell.line not in sheet.lines:
        message = "only numbers in a CSV next to the case can be changed"
        raise CaseError(cell.file, "", None, message)
    at, column = sheet.lines.index(cell.line), sheet.header.index(cell.column)
    row = sheet.rows[at]
    if len(set(numbers.values())) == 1:
        rows = [_replaced(row, column, next(iter(numbers.values())))]
    else:
        date = next(i for i, text in enumerate(row) if next(iter(numbers)).startswith(text))
        days = [[*row[:date], label, *row[date + 1 :]] for label in numbers]
        rows = [_replaced(day, column, x) for day, x in zip(days, numbers.values())]
    lines = [cell.line, *[0] * (len(rows) - 1)]
    return Sheet(
        sheet.header,
        [*sheet.rows[:at], *rows, *sheet.rows[at + 1 :]],
        [*sheet.lines[:at], *lines, *sheet.lines[at + 1 :]],
    )


def _replaced(row: list[str], column: int, number: float) -> list[str]:
    return [*row[:column], repr(number), *row[column + 1 :]]


def _leaves(value: Any, path: Key) -> Iterator[tuple[Key, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, (*path, key))
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for i, item in enumerate(value):
            yield from _leaves(item, (*path, i))
    elif not isinstance(value, datetime.date | bool):
        yield path, value


def _put(table: Any, key: Key, value: Any) -> Any:
    if not key:
        return value
    first, *rest = key
    if isinstance(table, list):
        assert isinstance(first, int)
        return [*table[:first], _put(table[first], tuple(rest), value), *table[first + 1 :]]
    old = table.get(first, {})
    return {**table, first: _put(old, tuple(rest), value)}
