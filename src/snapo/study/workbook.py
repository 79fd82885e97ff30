"""The tables of a run as one workbook: result.json, the CSVs, and the results of its parts.

The nested data of a part become tables. Arrays of equal length are the columns of a table, and the
records of a list are the rows of a table. A matrix has its rows and numbered columns. The single
values of a level are a table with two columns.
"""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.csv import NUMBER
from snapo.solver.tables import (
    MAX_NAME,
    TRAINING,
    Picture,
    SheetTable,
    flat,
    sensitivities_chart,
    write_tables,
)

from . import run_folder

MAX_DRAWN, MAX_LINES = 400, 4  # rows and columns of a chart
LEFT = ("seconds",)
NAME = "name"  # column for the name of a record in a table of tables
ROW = "row"  # the header of the first column, where rows have no label
SINGLE = ("what", "value")
DEEPEST = 8


def write_run(run: Path) -> Path:
    """Writes a run's workbook; returns its path."""
    result = run_folder.read_table(run / run_folder.RESULT) or {}
    tables = {"result": SheetTable(("what", "value"), list(flat(result)))}
    positions = {"result": run_folder.RESULT}
    for file in sorted(run.glob("*.csv")):
        header, *rows = list(_rows(file)) or [[]]
        if header:
            tables[file.stem] = SheetTable(header, rows, _picture(file.stem, header, rows))
            positions[file.stem] = file.name
    for file in sorted((run / run_folder.PARTS).glob("*.json")):
        for results in tables_in(run_folder.read_table(file) or {}):
            name = _name(results.path or (file.stem,), tables)
            single = results.header == SINGLE  # values that have nothing in common
            picture = None if single else _picture(name, results.header, _floats(results.rows))
            tables[name] = SheetTable(results.header, results.rows, picture)
            positions[name] = ", ".join((f"parts/{file.name}", *results.path))
    contents = SheetTable(("sheet", "of"), list(positions.items()))
    write_tables(run / run_folder.TABLES, {"contents": contents, **tables})
    return run / run_folder.TABLES


def _name(path: Sequence[str], taken: Mapping[str, Any]) -> str:
    """An unused name for a sheet, which contains as much of the path as fits."""
    complete = re.sub(r"[\[\]:*?/\\']", " ", " ".join(path)).strip() or "table"
    used = {item.lower() for item in (*taken, "contents")}
    short = complete[:MAX_NAME].strip()
    for number in count(2):
        if short.lower() not in used:
            return short
        end = f" {number}"
        short = complete[: MAX_NAME - len(end)].strip() + end
    raise AssertionError


def _floats(rows: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """The rows with integers as floats, as in the rows of a CSV."""
    return [[float(x) if type(x) is int else x for x in row] for row in rows]


def _rows(file: Path) -> Iterator[Sequence[Any]]:
    """The rows of a CSV, in which numbers are converted from text."""
    with file.open(encoding="utf-8-sig", newline="") as lines:
        for i, row in enumerate(csv.reader(lines)):
            yield row if i == 0 else [_value(cell) for cell in row]


def _value(cell: str) -> Any:
    return float(cell) if NUMBER.fullmatch(cell) else None if cell in ("", "nan") else cell


def _picture(name: str, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> Picture | None:
    """A chart of a table: lines for the training, and bars or lines of the first columns of numbers
    for other tables whose first column is a label. None if there are too many rows for a readable
    chart."""
    if name == Path(run_folder.HISTORY).stem and TRAINING.y[0] in header:
        return TRAINING
    numbers = [
        column
        for i, column in enumerate(header)
        if i and rows and all(len(row) == len(header) and type(row[i]) is float for row in rows)
    ]
    selected = [column for column in numbers if column not in LEFT][:MAX_LINES]
    if not selected or not 2 <= len(rows) <= MAX_DRAWN:
        return None
    if {"value", "label", "input"} <= set(header):
        return sensitivities_chart(list(rows))
    return Picture("line", header[0], selected)


class SheetPart(NamedTuple):
    """A table, and its path in the data of the part."""

    path: tuple[str, ...]
    header: tuple[str, ...]
    rows: Sequence[Sequence[Any]]


def tables_in(data: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[SheetPart]:
    """Every table in nested plain data, with the outer tables first."""
    single = {key: entry for key, entry in data.items() if not isinstance(entry, Mapping | list)}
    if single:
        yield SheetPart(path, SINGLE, list(single.items()))
    lists = {key: value for key, value in data.items() if isinstance(value, list) and value}
    yield from _side_by_side(lists, path)
    for key, item in lists.items():
        if all(isinstance(row, Mapping) for row in item):
            yield from _records(item, (*path, key))
        elif not _flat(item):
            yield from _matrix(item, (*path, key))
    nested = {key: each for key, each in data.items() if isinstance(each, Mapping)}
    if len(nested) > 1 and all(map(_record, nested.values())):
        yield from _records([{NAME: key, **each} for key, each in nested.items()], path)
        return
    for key, item in nested.items():
        yield from tables_in(item, (*path, key))


def _flat(values: list) -> bool:
    return not any(isinstance(value, Mapping | list) for value in values)


def _record(item: Mapping[str, Any]) -> bool:
    """Whether a table has single values only."""
    return bool(item) and not any(isinstance(value, Mapping | list) for value in item.values())


def _side_by_side(lists: Mapping[str, list], path: tuple[str, ...]) -> Iterator[SheetPart]:
    """Tables of the lists of single values; lists of equal length are in one table."""
    by_length: dict[int, list[str]] = {}
    for key, item in lists.items():
        if _flat(item):
            by_length.setdefault(len(item), []).append(key)
    for length, keys in by_length.items():
        labelled = all(isinstance(entry, str) for entry in lists[keys[0]])
        columns = [lists[key] for key in keys]
        if not labelled:
            columns = [list(range(1, length + 1)), *columns]
        header = tuple(keys) if labelled else (ROW, *keys)
        by_name = (*path, keys[0]) if len(by_length) > 1 and len(keys) == 1 else path
        yield SheetPart(by_name, header, list(zip(*columns)))


def _records(rows: list[Mapping[str, Any]], path: tuple[str, ...]) -> Iterator[SheetPart]:
    """A table with the records as rows; arrays in records become separate tables."""
    header = list(dict.fromkeys(key for row in rows for key in _plain(row)))
    if header:
        values: list[Sequence[Any]] = [[_plain(row).get(key) for key in header] for row in rows]
        yield SheetPart(path, tuple(header), values)
    if len(path) >= DEEPEST:
        return
    for i, row in enumerate(rows, 1):
        inner = {key: item for key, item in row.items() if isinstance(item, Mapping | list)}
        label = next((entry for entry in row.values() if isinstance(entry, str) and entry), str(i))
        yield from tables_in({k: v for k, v in inner.items() if not _in_words(v)}, (*path, label))


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a record that a row can hold; a list of texts becomes one text."""
    return {
        key: "; ".join(item) if _in_words(item) else item
        for key, item in row.items()
        if _in_words(item) or not isinstance(item, Mapping | list)
    }


def _in_words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _matrix(rows: list, path: tuple[str, ...]) -> Iterator[SheetPart]:
    """A table of a list of lists of single values; deeper lists have a table for every layer."""
    rows = [entry if isinstance(entry, list) else [entry] for entry in rows]
    if all(_flat(row) for row in rows):
        wide = max(map(len, rows))
        header = (ROW, *map(str, range(1, wide + 1)))
        yield SheetPart(path, header, [[i, *row] for i, row in enumerate(rows, 1)])
    elif len(path) < DEEPEST:
        for i, item in enumerate(rows, 1):
            yield from tables_in({str(i): item}, path)
