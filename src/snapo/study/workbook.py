"""The tables of a run as one workbook: result.json and every CSV of its folder."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from snapo.case.csv import NUMBER
from snapo.solver.show.tables import TRAINING, flat, sensitivities
from snapo.solver.show.workbook import Picture, Table, write_tables

from . import run_folder

MOST_DRAWN, MOST_LINES = 400, 4  # rows and columns of a chart
LEFT = ("seconds",)


def write_run(run: Path) -> Path:
    """Writes a run's workbook; returns its path."""
    result = run_folder.read_table(run / run_folder.RESULT) or {}
    tables = {"result": Table(("what", "value"), list(flat(result)))}
    for file in sorted(run.glob("*.csv")):
        header, *rows = list(_rows(file)) or [[]]
        if header:
            tables[file.stem] = Table(header, rows, _picture(file.stem, header, rows))
    write_tables(run / run_folder.TABLES, tables)
    return run / run_folder.TABLES


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
    if "held" in kept:
        return sensitivities(list(rows))
    return Picture("line", header[0], kept)
