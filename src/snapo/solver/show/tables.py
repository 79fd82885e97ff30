"""The tables of a solution, for a workbook."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..learning.progress import Record
from ..sensitivity import SensitivityRow
from .workbook import Picture, SheetTable

if TYPE_CHECKING:
    from ..solution import Solution

BINS = 40


def tables_of(solution: Solution) -> dict[str, SheetTable]:
    """Result, sensitivities, training, and the histogram of every output."""
    tables = {"result": SheetTable(("what", "value"), list(flat(solution.summary())))}
    if solution.sensitivities is not None:
        rows = list(solution.sensitivities.rows())
        tables["sensitivities"] = SheetTable(SensitivityRow._fields, rows, sensitivities(rows))
    if solution.history:
        tables["training"] = SheetTable(Record._fields, solution.history, TRAINING)
    for name, totals in solution.totals.items():
        values = np.asarray(totals, np.float64)
        counts, edges = np.histogram(values[np.isfinite(values)], BINS)
        rows = list(zip(edges[:-1].tolist(), edges[1:].tolist(), counts.tolist()))
        picture = Picture("bar", "from", ("paths",))
        tables[f"total {name}"] = SheetTable(("from", "to", "paths"), rows, picture)
    return tables


TRAINING = Picture("line", "step", ("objective",))


def sensitivities(rows: list[Any]) -> Picture | None:
    """Derivatives by label, or by input where most have none; no chart that is too long to read.

    `rows`: input, label …
    """
    labelled = sum(bool(row[1]) for row in rows) > len(rows) / 2
    return (
        Picture("bar", "label" if labelled else "input", ("value",)) if len(rows) <= 400 else None
    )


def flat(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested tables, with its way in words."""
    for key, value in table.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{name}, ")
        elif isinstance(value, list | tuple):
            yield name, "; ".join(map(str, value))
        else:
            yield name, value
