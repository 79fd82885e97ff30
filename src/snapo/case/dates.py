"""Numbers that hold from a date on: one plain number, or a CSV with columns date,value."""

import datetime
import math
from collections.abc import Sequence

import numpy as np

from .csv import FileReference, Row, read_rows
from .given import CaseInput
from .table import TableContext


def single(name: str, value: float, unit: str) -> CaseInput:
    """One plain number, used once (index [])."""
    return CaseInput(name, np.array([value], np.float64), ("",), unit, np.array(0))


def ordinals(days: Sequence[datetime.date]) -> np.ndarray:
    """[n] proleptic Gregorian day numbers, int64."""
    return np.array([day.toordinal() for day in days], np.int64)


def dated(
    section: TableContext,
    key: str,
    inputs: float | str,
    unit: str,
    days: Sequence[datetime.date],
    *,
    low: float = -math.inf,
    high: float = math.inf,
    before: float | None = None,
) -> CaseInput:
    """What was given under `key`, with its index [len(days)] on the rising dates `days`.

    A number in the file holds from its date on. Before the first date holds `before`, under a
    separate label and with a remark; without it the file must begin by the first of `days`.
    """
    if not isinstance(inputs, str):
        return CaseInput(
            key, np.array([inputs], np.float64), ("",), unit, np.zeros(len(days), np.int64)
        )
    rows = read_rows(FileReference(section, key, inputs), ("date", "value"))
    dates = rising_dates(rows)
    values = [row.number("value", low, high) for row in rows]
    labels = [date.isoformat() for date in dates]
    starts = ordinals(dates)
    if len(days) and dates[0] > days[0]:
        first = dates[0].isoformat()
        if before is None:
            message = f"{key} is needed from {days[0].isoformat()} on; add a row for that date"
            raise rows[0].error("date", message)
        section.notes.append(f"{inputs} begins on {first}; until then {key} is {before:g}.")
        values.insert(0, before)
        labels.insert(0, f"before {first}")
        starts = np.insert(starts, 0, days[0].toordinal())
    index = np.searchsorted(starts, ordinals(days), side="right") - 1
    return CaseInput(key, np.array(values), tuple(labels), unit, index)


def rising_dates(rows: Sequence[Row], column: str = "date") -> list[datetime.date]:
    """The dates of all rows, each after the one before."""
    dates: list[datetime.date] = []
    for row in rows:
        date = row.day(column)
        if dates and date <= dates[-1]:
            message = f"dates must rise, and the row before has {dates[-1].isoformat()}"
            raise row.error(column, message)
        dates.append(date)
    return dates
