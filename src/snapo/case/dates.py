"""The dates of the rows of a CSV, each of which holds from its date on."""

import datetime
from collections.abc import Sequence

import numpy as np

from .csv import Row


def ordinals(days: Sequence[datetime.date]) -> np.ndarray:
    """[n] proleptic Gregorian day numbers, int64."""
    return np.array([day.toordinal() for day in days], np.int64)


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
