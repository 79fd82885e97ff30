"""The tables of a run as one workbook: result.json, the CSVs, and the results of its parts.

Of nested data of a part, arrays that are equally long are columns of one table; records that follow
one another are its rows; a matrix has its rows and numbered columns; single values of a level are a
table of two columns.
"""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.csv import NUMBER
from snapo.solver.show.tables import TRAINING, flat, sensitivities
from snapo.solver.show.workbook import MOST_NAME, Picture, Table, write_tables

from . import run_folder

MOST_DRAWN, MOST_LINES = 400, 4  # rows and columns of a chart
LEFT = ("seconds",)
NAME = "name"  # of that of records in a table of tables
ROW = "row"  # the header of the first column, where rows have no label of their own
SINGLE = ("what", "value")
DEEPEST = 8


def write_run(run: Path) -> Path:
    """Writes a run's workbook; returns its path."""
    result = run_folder.read_table(run / run_folder.RESULT) or {}
    tables = {"result": Table(("what", "value"), list(flat(result)))}
    places = {"result": run_folder.RESULT}
    for file in sorted(run.glob("*.csv")):
        header, *rows = list(_rows(file)) or [[]]
        if header:
            tables[file.stem] = Table(header, rows, _picture(file.stem, header, rows))
            places[file.stem] = file.name
    for file in sorted((run / run_folder.PARTS).glob("*.json")):
        for found in tables_in(run_folder.read_table(file) or {}):
            name = _name(found.way or (file.stem,), tables)
            single = found.header == SINGLE  # values that have nothing in common
            picture = None if single else _picture(name, found.header, _floats(found.rows))
            tables[name] = Table(found.header, found.rows, picture)
            places[name] = ", ".join((f"parts/{file.name}", *found.way))
    contents = Table(("sheet", "of"), list(places.items()))
    write_tables(run / run_folder.TABLES, {"contents": contents, **tables})
    return run / run_folder.TABLES


def _name(way: Sequence[str], taken: Mapping[str, Any]) -> str:
    """A name for a sheet that is not taken, as much of the way as there is room for."""
    whole = re.sub(r"[\[\]:*?/\\']", " ", " ".join(way)).strip() or "table"
    used = {each.lower() for each in (*taken, "contents")}
    short = whole[:MOST_NAME].strip()
    for number in count(2):
        if short.lower() not in used:
            return short
        end = f" {number}"
        short = whole[: MOST_NAME - len(end)].strip() + end
    raise AssertionError


def _floats(rows: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Whole numbers as those of a CSV."""
    return [[float(x) if type(x) is int else x for x in row] for row in rows]


def _rows(file: Path) -> Iterator[Sequence[Any]]:
    """The rows of a CSV, numbers as numbers."""
    with file.open(encoding="utf-8-sig", newline="") as lines:
        for i, row in enumerate(csv.reader(lines)):
            yield row if i == 0 else [_value(cell) for cell in row]


def _value(cell: str) -> Any:
    return float(cell) if NUMBER.fullmatch(cell) else None if cell in ("", "nan") else cell


def _picture(name: str, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> Picture | None:
    """Training as a line; other tables whose first column is a label, as bars or lines of their
    first columns of numbers; none where there are too many rows to be read."""
    if name == Path(run_folder.HISTORY).stem and TRAINING.y[0] in header:
        return TRAINING
    numbers = [
        column
        for i, column in enumerate(header)
        if i and rows and all(len(row) == len(header) and type(row[i]) is float for row in rows)
    ]
    kept = [column for column in numbers if column not in LEFT][:MOST_LINES]
    if not kept or not 2 <= len(rows) <= MOST_DRAWN:
        return None
    if {"value", "label", "input"} <= set(header):
        return sensitivities(list(rows))
    return Picture("line", header[0], kept)


class Part(NamedTuple):
    """A table, and the way to it in the part's data."""

    way: tuple[str, ...]
    header: tuple[str, ...]
    rows: Sequence[Sequence[Any]]


def tables_in(data: Mapping[str, Any], way: tuple[str, ...] = ()) -> Iterator[Part]:
    """Every table in nested plain data, the outer ones first."""
    single = {key: each for key, each in data.items() if not isinstance(each, Mapping | list)}
    if single:
        yield Part(way, SINGLE, list(single.items()))
    lists = {key: each for key, each in data.items() if isinstance(each, list) and each}
    yield from _side_by_side(lists, way)
    for key, each in lists.items():
        if all(isinstance(row, Mapping) for row in each):
            yield from _records(each, (*way, key))
        elif not _flat(each):
            yield from _matrix(each, (*way, key))
    nested = {key: each for key, each in data.items() if isinstance(each, Mapping)}
    if len(nested) > 1 and all(map(_record, nested.values())):
        yield from _records([{NAME: key, **each} for key, each in nested.items()], way)
        return
    for key, each in nested.items():
        yield from tables_in(each, (*way, key))


def _flat(values: list) -> bool:
    return not any(isinstance(each, Mapping | list) for each in values)


def _record(each: Mapping[str, Any]) -> bool:
    """Whether a table has single values alone."""
    return bool(each) and not any(isinstance(value, Mapping | list) for value in each.values())


def _side_by_side(lists: Mapping[str, list], way: tuple[str, ...]) -> Iterator[Part]:
    """Lists of single values, those of one length in one table."""
    by_length: dict[int, list[str]] = {}
    for key, each in lists.items():
        if _flat(each):
            by_length.setdefault(len(each), []).append(key)
    for length, keys in by_length.items():
        labelled = all(isinstance(each, str) for each in lists[keys[0]])
        columns = [lists[key] for key in keys]
        if not labelled:
            columns = [list(range(1, length + 1)), *columns]
        header = tuple(keys) if labelled else (ROW, *keys)
        named = (*way, keys[0]) if len(by_length) > 1 and len(keys) == 1 else way
        yield Part(named, header, list(zip(*columns)))


def _records(rows: list[Mapping[str, Any]], way: tuple[str, ...]) -> Iterator[Part]:
    """Records as rows; of records that hold arrays, these are tables of their own."""
    header = list(dict.fromkeys(key for row in rows for key in _plain(row)))
    if header:
        values: list[Sequence[Any]] = [[_plain(row).get(key) for key in header] for row in rows]
        yield Part(way, tuple(header), values)
    if len(way) >= DEEPEST:
        return
    for i, row in enumerate(rows, 1):
        inner = {key: each for key, each in row.items() if isinstance(each, Mapping | list)}
        label = next((each for each in row.values() if isinstance(each, str) and each), str(i))
        yield from tables_in({k: v for k, v in inner.items() if not _in_words(v)}, (*way, label))


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a record that a row can hold: a list of words is joined."""
    return {
        key: "; ".join(each) if _in_words(each) else each
        for key, each in row.items()
        if _in_words(each) or not isinstance(each, Mapping | list)
    }


def _in_words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, str) for each in value)


def _matrix(rows: list, way: tuple[str, ...]) -> Iterator[Part]:
    """A list of lists of single values; deeper ones layer by layer."""
    rows = [each if isinstance(each, list) else [each] for each in rows]
    if all(_flat(row) for row in rows):
        wide = max(map(len, rows))
        header = (ROW, *map(str, range(1, wide + 1)))
        yield Part(way, header, [[i, *row] for i, row in enumerate(rows, 1)])
    elif len(way) < DEEPEST:
        for i, each in enumerate(rows, 1):
            yield from tables_in({str(i): each}, way)
