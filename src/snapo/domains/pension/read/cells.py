"""Reads cells of the tables: optional cells, keywords, names and times."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.case.csv import Row
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import CaseTable, TableContext, nearest

NEVER = 1e-9  # of a year: two times closer than this are one


WHOLE = 1e-6  # of a step, or of all weights: closer than this is a whole


class TimeGrid(NamedTuple):
    """The grid of all tables: the number of decisions, the years of a step, the currency."""

    steps: int
    step: float
    currency: str


@dataclass(frozen=True)
class TableReader(TableContext):
    """A table of a case while it is read; `defaulted` collects the numbers left at a default."""

    defaulted: set[str]

    def input(self, table: CaseTable, key: str, values: CaseInput) -> CaseInput:
        """A number from `key`; it is not an input if the case does not have the key."""
        if key not in table.model_fields_set:
            self.defaulted.add(values.name)
        return values


def empty(name: str, shape: tuple[int, ...] = (0,)) -> CaseInput:
    """A number that the case does not have: it has no value, and counts as zeros of `shape`."""
    return CaseInput(name, np.zeros(0), (), "1", np.zeros(shape, np.int64))


def number(row: Row, column: str, default: float, low=-math.inf, high=math.inf) -> float:
    """The number in a cell; `default` if the column or the cell is missing."""
    return row.number(column, low, high) if row.cells.get(column) else default


def word(row: Row, column: str, available: Sequence[str]) -> str:
    """The word in a cell, in lower case; it must be one of those `available`."""
    text = row.cells[column].lower()
    if text not in available:
        raise row.error(column, f"it must be one of {', '.join(available)}")
    return text


def position(row: Row, column: str, names: Sequence[str], subject: str) -> int:
    """The index in `names` of the name in a cell; -1 for an empty or absent cell."""
    text = row.cells.get(column, "")
    if not text:
        return -1
    if text not in names:
        raise row.error(
            column, f"there is no such {subject}; available: {', '.join(names) or 'none'}"
        )
    return list(names).index(text)


def unique(rows: Sequence[Row], column: str) -> tuple[str, ...]:
    """The names in a column; a name must not be empty or occur twice."""
    names: list[str] = []
    for row in rows:
        if not row.cells[column]:
            raise row.error(column, "every row needs a name")
        if row.cells[column] in names:
            raise row.error(column, "an earlier row has this name already")
        names.append(row.cells[column])
    return tuple(names)


def rising(rows: Sequence[Row], column: str, minimum: float = 0.0) -> np.ndarray:
    """The numbers of a column, each above the one before and all above `minimum`."""
    values: list[float] = []
    for row in rows:
        value = row.number(column)
        if value <= minimum and not values:
            raise row.error(column, f"it must be a number above {minimum:g}")
        if values and value <= values[-1]:
            raise row.error(column, f"{column}s must increase; the previous row has {values[-1]:g}")
        values.append(value)
    return np.array(values)


def years(value: float) -> str:
    """A time as text: "10y", or "18m" for whole months, else "2.35y"."""
    if abs(value - round(value)) < NEVER:
        return f"{round(value)}y"
    months = 12 * value
    return f"{round(months)}m" if abs(months - round(months)) < 1e-3 else f"{value:g}y"


def whole_steps(row: Row, column: str, step: float) -> int:
    """A time in years that is a whole number of steps, at least one."""
    steps = row.number(column, step, 100.0) / step
    if abs(steps - round(steps)) > WHOLE:
        raise row.error(column, f"it must be a whole number of steps of {years(step)}")
    return round(steps)


def known_words(
    file: str,
    where: str,
    values: Sequence[str],
    available: Sequence[str],
    missing: str = "there is no such name",
) -> None:
    """Checks that every word of a list is valid and occurs once."""
    for i, item in enumerate(values):
        if item not in available:
            raise CaseError(file, where, item, f"{missing}; {nearest(item, available)}")
        if item in values[:i]:
            raise CaseError(file, where, item, "this name appears twice")
