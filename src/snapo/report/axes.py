"""Axes that read well: dates by month or by day, numbers with separators."""

import datetime
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .quantity import MAXIMUM, MONTHS, TINY, decimals, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis


def days(values: Sequence[str]) -> np.ndarray:
    """ISO dates [T] as numbers of a date axis [T]."""
    from matplotlib import dates as mdates

    return np.array([mdates.date2num(datetime.date.fromisoformat(day)) for day in values])


def date_axis(axes: "Axes", first: float, last: float) -> None:
    """Ticks at month starts, the year under each January and the first; at days when short."""
    from matplotlib import dates as mdates

    axes.set_xlim(first, max(last, first + 1))
    span = last - first
    if span > 75:
        step = next((step for step in (1, 2, 3, 6, 12) if span / 30.4 / step <= 14), 24)
        ticks = [
            month_start
            for month_start in _month_starts(first, last)
            if month_start.month % step == 1 % step
        ]
        texts = [_month_text(tick, i == 0) for i, tick in enumerate(ticks)]
    else:
        every = max(1, round(span / 12))
        ticks = [mdates.num2date(day) for day in np.arange(first, last + 0.5, every)]
        texts = [_day_text(item, i == 0) for i, item in enumerate(ticks)]
    axes.set_xticks([float(mdates.date2num(entry)) for entry in ticks], texts)


def _month_starts(first: float, last: float) -> list[datetime.date]:
    from matplotlib import dates as mdates

    start, end = mdates.num2date(first).date(), mdates.num2date(last).date()
    count = (end.year - start.year) * 12 + end.month - start.month + 1
    months = [start.year * 12 + start.month - 1 + i for i in range(count)]
    starts = [datetime.date(month // 12, month % 12 + 1, 1) for month in months]
    return [item for item in starts if start <= item <= end]


def _month_text(item: datetime.date, first: bool) -> str:
    month = MONTHS.split()[item.month - 1][:3]
    return f"{month}\n{item.year}" if first or item.month == 1 else month


def _day_text(item: datetime.datetime, first: bool) -> str:
    month = MONTHS.split()[item.month - 1][:3]
    return f"{item.day}\n{month} {item.year}" if first else f"{item.day}\n{month}"


def number_axis(axis: "Axis", count: int = 6) -> None:
    """Round numbers with thousands separators, as many decimals as their spacing needs."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))

    def text(value: float, position: int | None) -> str:
        ticks = axis.get_majorticklocs()
        gap = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
        digits = decimals([gap], 1)
        if abs(gap * 10**digits - round(gap * 10**digits)) > 1e-6:
            digits += 1  # a spacing of 2.5 or 0.25
        if 0 < np.abs(ticks).max() < TINY:
            digits = max(digits, MAXIMUM + 1)  # all of them as powers of ten
        return number(value, digits)

    axis.set_major_formatter(FuncFormatter(text))
