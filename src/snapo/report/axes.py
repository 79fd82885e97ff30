"""Axes that read well: dates by month or by day, numbers with separators."""

import datetime
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .quantity import MONTHS, MOST, TINY, decimals, number

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
        ticks = [each for each in _month_starts(first, last) if each.month % step == 1 % step]
        texts = [_month_text(each, i == 0) for i, each in enumerate(ticks)]
    else:
        every = max(1, round(span / 12))
        ticks = [mdates.num2date(day) for day in np.arange(first, last + 0.5, every)]
        texts = [_day_text(each, i == 0) for i, each in enumerate(ticks)]
    axes.set_xticks([float(mdates.date2num(each)) for each in ticks], texts)


def _month_starts(first: float, last: float) -> list[datetime.date]:
    from matplotlib import dates as mdates

    begin, end = mdates.num2date(first).date(), mdates.num2date(last).date()
    count = (end.year - begin.year) * 12 + end.month - begin.month + 1
    months = [begin.year * 12 + begin.month - 1 + i for i in range(count)]
    starts = [datetime.date(month // 12, month % 12 + 1, 1) for month in months]
    return [each for each in starts if begin <= each <= end]


def _month_text(each: datetime.date, first: bool) -> str:
    month = MONTHS.split()[each.month - 1][:3]
    return f"{month}\n{each.year}" if first or each.month == 1 else month


def _day_text(each: datetime.datetime, first: bool) -> str:
    month = MONTHS.split()[each.month - 1][:3]
    return f"{each.day}\n{month} {each.year}" if first else f"{each.day}\n{month}"


def number_axis(axis: "Axis", count: int = 6) -> None:
    """Round numbers with thousands separators, as many decimals as their spacing needs."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))

    def text(value: float, position: int | None) -> str:
        ticks = axis.get_majorticklocs()
        gap = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
        places = decimals([gap], 1)
        if abs(gap * 10**places - round(gap * 10**places)) > 1e-6:
            places += 1  # a spacing of 2.5 or 0.25
        if 0 < np.abs(ticks).max() < TINY:
            places = max(places, MOST + 1)  # all of them as powers of ten
        return number(value, places)

    axis.set_major_formatter(FuncFormatter(text))
