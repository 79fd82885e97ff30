"""The axes of a book: other values for keys of its cases, on a grid, at Sobol points, or both.

A number takes the unit that the case has at its key: 20 is "20 degC" where the case has "5 degC".
"""

import datetime
import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from snapo.case.error import CaseError
from snapo.case.table import CaseTable, doc, parse
from snapo.case.toml import one_value
from snapo.study.assign import value_at

CaseKey = Annotated[str, Field(pattern=r"^[^.]+(\.[^.]+)*$")]

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
WITH_UNIT = re.compile(rf"({NUMBER})\s*(\S.*)", re.ASCII)
RANGE = re.compile(rf"\s*({NUMBER})\s*:\s*({NUMBER})\s*(?::\s*([^\s:]+)\s*)?(.*)", re.ASCII)
MAX_POINTS = 100_000
VALUES = 'numbers, or "5:35:7" for seven numbers from 5 to 35'
SCALARS = (bool, int, float, str, datetime.date)


class AxisTable(CaseTable):
    """`[[axis]]`"""

    key: CaseKey = doc("key of the axis", allowed='a key of the cases, "contract.max_inventory"')
    values: str | list[bool | float | str | datetime.date] = doc("values of the key", "", VALUES)
    range: str = doc("range of Sobol points", "", 'first and last number of Sobol points, "5:35"')
    sobol: int | None = doc(
        "number of Sobol points", None, "a number of Sobol points, 1 or more", ge=1, le=MAX_POINTS
    )


class AxisValue(NamedTuple):
    """A value of an axis, and its text in names, labels and tables."""

    value: Any
    text: str

    @classmethod
    def of(cls, value: Any, unit: str = "") -> "AxisValue":
        """Makes a value of an axis; `unit`: the unit that was written after the numbers of the
        axis."""
        if isinstance(value, str):
            return cls(value, value)
        text = one_value(value) if isinstance(value, bool | datetime.date) else f"{value:.12g}"
        return cls(f"{text} {unit}", f"{text} {unit}") if unit else cls(value, text)


class Axis(NamedTuple):
    """An axis: its key, and the short name of the key."""

    key: str
    label: str


AxisPoint = tuple[AxisValue, ...]  # a value of every axis


class Design(NamedTuple):
    """The axes of a book, and the points at which its contracts are valued (one point if there are
    no axes)."""

    axes: tuple[Axis, ...] = ()
    points: tuple[AxisPoint, ...] = ((),)

    def labels(self, point: AxisPoint) -> dict[str, str]:
        """{label of an axis: the text of its value}."""
        return {axis.label: value.text for axis, value in zip(self.axes, point)}

    def settings(self, tables: Mapping[str, Any], point: AxisPoint) -> list[tuple[str, str]]:
        """The pairs (key, value as TOML) of a point, with the units that these tables of a case
        have."""
        return [(axis.key, _toml(tables, axis.key, x)) for axis, x in zip(self.axes, point)]


def number_of(text: str) -> float | None:
    """The number in the text of a value, with or without a unit; None if there is no number."""
    match = re.match(NUMBER + r"(?=\s|$)", text, re.ASCII)
    return float(match[0]) if match else None


def _toml(tables: Mapping[str, Any], key: str, value: AxisValue) -> str:
    if isinstance(value.value, bool) or not isinstance(value.value, int | float):
        return one_value(value.value)
    here = value_at(tables, key)
    unit = WITH_UNIT.fullmatch(here.strip()) if isinstance(here, str) else None
    return one_value(f"{value.text} {unit[2]}") if unit else value.text


def read_design(
    file: Path, entries: Sequence[Mapping[str, Any]], seed: int, columns: Collection[str] = ()
) -> Design:
    """The design of the tables `[[axis]]`: the product of its axes. Axes with Sobol points together
    count as one axis, scrambled with `seed`. `columns`: the labels of the contracts.

    **Raises:** `CaseError` for every mistake in them.
    """
    where = [f"axis[{i + 1}]" for i in range(len(entries))]
    tables = [parse(AxisTable, x, str(file), name) for x, name in zip(entries, where)]
    keys = [table.key for table in tables]
    for i, key in enumerate(keys):
        if key in keys[:i]:
            raise CaseError(str(file), f"{where[i]}.key", key, "two axes have this key")
    ranges = [_range_of(str(file), name, table) for table, name in zip(tables, where)]
    sobol = [i for i, of_sobol in enumerate(ranges) if of_sobol is not None]
    groups = list[tuple[list[int], list[AxisPoint]]]()
    for i, table in enumerate(tables):
        if i not in sobol:
            values = _values(str(file), f"{where[i]}.values", table.values)
            groups.append(([i], [(value,) for value in values]))
        elif i == sobol[0]:
            groups.append((sobol, _sobol(str(file), where, tables, ranges, seed)))
    order = [i for members, _ in groups for i in members]
    count = int(np.prod([float(len(points)) for _, points in groups]))
    if count > MAX_POINTS:
        message = f"{count:,} points; at most {MAX_POINTS:,} are allowed"
        raise CaseError(str(file), "axis", None, message)
    points = []
    for parts in itertools.product(*(points for _, points in groups)):
        by_axis = dict(zip(order, itertools.chain.from_iterable(parts)))
        points.append(tuple(by_axis[i] for i in range(len(tables))))
    labels = _labels(keys, columns)
    return Design(tuple(map(Axis, keys, labels)), tuple(points))


def _labels(keys: Sequence[str], columns: Collection[str]) -> list[str]:
    """For each key, the shortest last part that no other key or column has; it is no number."""
    labels = list[str]()
    for key in keys:
        parts = key.split(".")
        suffixes = [".".join(parts[i:]) for i in reversed(range(len(parts)))]
        free = [
            suffix
            for suffix in suffixes
            if not suffix.split(".")[0].isdigit()
            and suffix not in columns
            and not any(f".{other}".endswith(f".{suffix}") for other in keys if other != key)
        ]
        labels.append(free[0] if free else key)
    return labels


class _Range(NamedTuple):
    first: float
    last: float
    unit: str


def _range_of(file: str, where: str, table: AxisTable) -> _Range | None:
    """The range of an axis of Sobol points; None for an axis of values."""
    if table.sobol is None:
        if table.range:
            message = "a range is for Sobol points: also write sobol = 64, or write values instead"
            raise CaseError(file, f"{where}.range", table.range, message)
        return None
    if table.values:
        message = 'Sobol points need a range = "5:35"; an axis has either values or Sobol points'
        raise CaseError(file, f"{where}.values", table.values, message)
    match = RANGE.fullmatch(table.range)
    allowed = 'first and last number of the Sobol points, "5:35"'
    if match is None or match[3] is not None or not _ascending(match[1], match[2]):
        raise CaseError(file, f"{where}.range", table.range or None, allowed)
    return _Range(float(match[1]), float(match[2]), match[4].strip())


def _ascending(first: str, last: str) -> bool:
    return isfinite(float(first)) and isfinite(float(last)) and float(first) < float(last)


def _sobol(
    file: str,
    where: Sequence[str],
    tables: Sequence[AxisTable],
    ranges: Sequence[_Range | None],
    seed: int,
) -> list[AxisPoint]:
    """The points of all axes with Sobol points together."""
    from scipy.stats import qmc

    selected = [(i, item) for i, item in enumerate(ranges) if item is not None]
    count = tables[selected[0][0]].sobol or 0
    for i, _ in selected:
        if tables[i].sobol != count:
            message = (
                f"it must be {count}, as for the axis above: all axes share their Sobol points"
            )
            raise CaseError(file, f"{where[i]}.sobol", tables[i].sobol, message)
    engine = qmc.Sobol(len(selected), scramble=True, rng=np.random.default_rng(seed))
    # Sobol points come in powers of two.
    unit = engine.random(1 << (count - 1).bit_length())[:count]
    return [
        tuple(
            AxisValue.of(item.first + (item.last - item.first) * float(x), item.unit)
            for x, (_, item) in zip(row, selected)
        )
        for row in unit
    ]


def _values(file: str, where: str, values: str | list[Any]) -> list[AxisValue]:
    if isinstance(values, list):
        if not values:
            raise CaseError(file, where, values, "an axis must have at least one value")
        return [AxisValue.of(value) for value in values]
    return list(spaced(file, where, values))


def spaced(file: str, where: str, text: str) -> Iterator[AxisValue]:
    """The numbers that a text such as "5:35:7" describes.

    **Raises:** `CaseError` if the text does not have this form.
    """
    allowed = 'the first and the last number, and how many values, 2 or more: "5:35:7"'
    match = RANGE.fullmatch(text)
    if match is None or match[3] is None:
        raise CaseError(file, where, text or None, allowed)
    first, last, count = float(match[1]), float(match[2]), match[3]
    if not isfinite(first) or not isfinite(last):
        raise CaseError(file, where, text, allowed)
    size = int(count) if count.isascii() and count.isdigit() and len(count) < 7 else 0
    if not 2 <= size <= MAX_POINTS:
        raise CaseError(file, where, text, allowed + _as_step(first, last, count))
    unit = match[4].strip()
    for i in range(size):
        yield AxisValue.of(first + (last - first) * i / (size - 1), unit)


def _as_step(first: float, last: float, step: str) -> str:
    """The range to write if the third number was meant as a step."""
    number = number_of(step)
    if not number or not 1 <= (last - first) / number < MAX_POINTS:
        return ""
    count = round((last - first) / number) + 1
    return f"; in steps of {number:g} it is {first:g}:{first + (count - 1) * number:g}:{count}"
