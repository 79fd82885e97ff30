"""The tables of a run as one workbook: result.json, the CSVs, and all that its parts found."""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

from snapo.case.csv import NUMBER
from snapo.solver.show.tables import TRAINING, flat, sensitivities
from snapo.solver.show.workbook import MOST_NAME, Picture, Table, write_tables

from . import run_folder
from .part_tables import SINGLE, tables_in

MOST_DRAWN, MOST_LINES = 400, 4  # rows and columns of a chart
LEFT = ("seconds",)


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
