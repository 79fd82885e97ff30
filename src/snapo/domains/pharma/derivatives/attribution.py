"""Which way a parameter reaches an attribute: every sensitivity split by path through the units.

By the chain rule the derivative is the sum over all paths of the product of the units' own
derivatives along it; that the paths add up to the adjoint's number checks both.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from ..given import Entry
from ..quality.records import Attribute, Parameter
from .local import DerivativeBlock, Local


class Path(NamedTuple):
    """A way through the flowsheet, from the unit that the parameter acts in to the one where the
    attribute is measured, and its contribution, in the case's units."""

    units: tuple[str, ...]
    value: float


class Split(NamedTuple):
    """`paths`: {(attribute, parameter): paths}; without an entry nothing connects the two.

    `closure`: [Q, P] |sum of paths - matrix| over the largest of the matrix's row.
    """

    paths: dict[tuple[str, str], tuple[Path, ...]]
    closure: np.ndarray


def split(case: PharmaCase, blocks: Local, raw: np.ndarray) -> Split:
    """Every entry of `raw` [Q, P], the case's units, as a sum over paths."""
    table: dict[tuple[str, str], tuple[Path, ...]] = {}
    total = np.zeros(raw.shape)
    for q, attribute in enumerate(case.attributes):
        for p, parameter in enumerate(case.parameters):
            every = _paths(blocks.units, attribute, parameter)
            ways = tuple(path for path in every if path.value != 0)
            if ways:
                table[attribute.name, parameter.name] = ways
                total[q, p] = sum(key_path.value for key_path in ways)
    largest = np.abs(raw).max(1, keepdims=True)
    closure = np.abs(total - raw) / np.where(largest > 0, largest, 1.0)
    return Split(table, closure)


def _paths(
    units: dict[str, DerivativeBlock], attribute: Attribute, parameter: Parameter
) -> Iterator[Path]:
    end = next(name for name, unit in units.items() if attribute.measure in unit.measures)
    row = units[end].measures.index(attribute.measure)
    entry: Entry = (parameter.input, parameter.entry)
    scale = attribute.scale * parameter.scale
    for start, block in units.items():
        if entry not in block.entries:
            continue
        column = block.entries.index(entry)
        if start == end:
            yield Path((start,), float(scale * block.measure_by_entry[row, column]))
        outlets = block.stream_by_entry[:, :, column]
        for path, value in _onward(units, start, outlets, end, row):
            yield Path((start, *path), float(scale * value))


def _onward(
    units: dict[str, DerivativeBlock], here: str, changes: np.ndarray, end: str, row: int
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Ways from the outlets of `here`, which change by `changes` [outlets, K], to the measure."""
    for name, block in units.items():
        inlets = [
            (units[here].outlets.index(stream), i)
            for i, stream in enumerate(block.inlets)
            if stream in units[here].outlets
        ]
        if not inlets or not any(changes[outlet].any() for outlet, _ in inlets):
            continue
        if name == end:
            value = sum(block.measure[row, i] @ changes[outlet] for outlet, i in inlets)
            yield (name,), float(value)
        further = sum(block.stream[:, :, i] @ changes[outlet] for outlet, i in inlets)
        if np.any(further):
            for path, value in _onward(units, name, np.asarray(further), end, row):
                yield (name, *path), value


def by_unit(case: PharmaCase, result: Split) -> dict[tuple[str, str], float]:
    """{(unit where parameters act, attribute): root of the summed squares over half the normal
    range}: the importance of units for attributes, over all their parameters."""
    half = {item.name: (item.normal_high - item.normal_low) / 2 / item.scale
            for item in case.parameters}  # fmt: skip
    squares: dict[tuple[str, str], float] = {}
    for (attribute, parameter), ways in result.paths.items():
        for start in dict.fromkeys(path.units[0] for path in ways):
            value = sum(key_path.value for key_path in ways if key_path.units[0] == start)
            key = (start, attribute)
            squares[key] = squares.get(key, 0.0) + (value * half[parameter]) ** 2
    return {key: float(np.sqrt(value)) for key, value in squares.items()}
