"""A case as it stands in files: its tables and the text of every file beside it, in memory."""

import csv
import datetime
import io
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.csv import NUMBER
from snapo.case.toml import to_toml
from snapo.study.run_folder import case_files

Key = tuple[str | int, ...]  # the way to a value in the tables


class Sheet(NamedTuple):
    """A CSV: its header and its rows, as texts; comments are left out."""

    header: list[str]
    rows: list[list[str]]

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

    def leaves(self) -> Iterator[tuple[Key, Any]]:
        """All values of the tables that are no tables, with the way to each."""
        return _leaves(self.tables, ())

    def with_value(self, key: Key, value: Any) -> "Files":
        """The case with another value at one place of its tables."""
        return replace(self, tables=_put(self.tables, key, value))

    def without(self, names: Sequence[str]) -> "Files":
        """The case without these tables."""
        return replace(self, tables={k: v for k, v in self.tables.items() if k not in names})

    def with_sheet(self, name: str, sheet: Sheet) -> "Files":
        """The case with another CSV of this name."""
        return replace(self, sheets={**self.sheets, name: sheet}, changed=self.changed | {name})

    def write(self, folder: Path) -> Path:
        """The case in a folder of its own: case.toml and its files; returns the file."""
        folder.mkdir(parents=True, exist_ok=True)
        for each in case_files(self.folder):
            if each.suffix.lower() != ".toml" and each.name not in self.changed:
                target = folder / each.name
                if not target.exists():
                    shutil.copyfile(each, target)
        for name in self.changed:
            (folder / name).write_text(self.sheets[name].text(), encoding="utf-8")
        file = folder / "case.toml"
        file.write_text(to_toml(self.tables), encoding="utf-8")
        return file


def read_files(folder: Path, tables: Mapping[str, Any]) -> Files:
    """The case whose tables were read from `folder`, with the CSVs that they name."""
    named = {value for _, value in _leaves(tables, ()) if isinstance(value, str)}
    sheets = {}
    for each in case_files(folder):
        if each.name in named and each.suffix.lower() == ".csv":
            sheets[each.name] = _sheet(each.read_text(encoding="utf-8-sig"))
    return Files(folder, tables, sheets)


def _sheet(text: str) -> Sheet:
    rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines())]
    rows = [row for row in rows if any(row) and not row[0].startswith("#")]
    return Sheet(rows[0], rows[1:]) if rows else Sheet([], [])


def numbers_in(cells: Sequence[str]) -> list[float] | None:
    """A column as numbers; None where a cell is something else."""
    if not cells or not all(NUMBER.fullmatch(cell) for cell in cells):
        return None
    return [float(cell) for cell in cells]


def _leaves(value: Any, way: Key) -> Iterator[tuple[Key, Any]]:
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _leaves(each, (*way, key))
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for i, each in enumerate(value):
            yield from _leaves(each, (*way, i))
    elif not isinstance(value, datetime.date | bool):
        yield way, value


def _put(table: Any, key: Key, value: Any) -> Any:
    if not key:
        return value
    first, *rest = key
    if isinstance(table, list):
        assert isinstance(first, int)
        return [*table[:first], _put(table[first], tuple(rest), value), *table[first + 1 :]]
    old = table.get(first, {})
    return {**table, first: _put(old, tuple(rest), value)}
