"""The tables of a solution, for a workbook."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .workbook import Picture, SheetTable

BINS = 40


TRAINING = Picture("line", "step", ("objective",))


def sensitivities_chart(rows: list[Any]) -> Picture | None:
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


def histogram(totals: np.ndarray) -> SheetTable:
    """How many paths have a total between two numbers."""
    values = np.asarray(totals, np.float64)
    counts, edges = np.histogram(values[np.isfinite(values)], BINS)
    rows = list(zip(edges[:-1].tolist(), edges[1:].tolist(), counts.tolist()))
    return SheetTable(("from", "to", "paths"), rows, Picture("bar", "from", ("paths",)))
