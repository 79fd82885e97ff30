"""The design space: the probability that all limits hold, over two or three parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from snapo.solver.statistics import proportion
from snapo.study.chapter import Floats, Number

from ..flowsheet.case import PharmaCase
from ..given import Entry
from . import batches
from .batches import AttributeLimits
from .boundary import Boundary, boundaries, distances, interval
from .records import Parameter

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess


class Point(NamedTuple):
    """The results of n draws at one set point or more; the leading axes of the arrays are the set
    points.

    - `probability`: the probability that all limits hold; `error`: its standard error.
    - `by_attribute`: […, Q] the probability that the limits of each attribute hold; `mean`: […, Q]
      the mean of each attribute.
    - `binding`: the attribute that most often violates its limits, -1 if none does.
    - `failed`: the share of runs without a finite result; they break every limit.
    - `low`, `high`: 95 % interval of the probability.
    """

    probability: np.ndarray
    error: np.ndarray
    by_attribute: np.ndarray
    mean: np.ndarray
    binding: np.ndarray
    failed: np.ndarray
    low: np.ndarray
    high: np.ndarray


class ProbabilityMap(NamedTuple):
    """`axes`: names; `grid`: the points of every axis in the case's unit; `at`: the `Point` of the
    whole map; `boundaries`: where the space ends along the lines of the map."""

    axes: tuple[str, ...]
    grid: tuple[np.ndarray, ...]
    at: Point
    samples: int
    boundaries: tuple[Boundary, ...] = ()


def probability_map(process: "PharmaProcess", seed: int) -> ProbabilityMap:
    """The map requested by `[design_space]` of the case; the same draws at every point."""
    case: PharmaCase = process.case
    space = case.design_space
    if space is None:
        raise ValueError("the case has no [design_space]")
    selected = tuple(parameter(case, name) for name in space.axes)
    grid = [np.linspace(item.low, item.high, n) for item, n in zip(selected, space.points)]
    points = np.stack([x.ravel() for x in np.meshgrid(*grid, indexing="ij")], -1)
    entries = [(entry.input, entry.entry) for entry in selected]
    changes = [dict(zip(entries, point)) for point in points]
    values = drawn_values(process, changes, space.samples, seed)
    shape = tuple(space.points)
    result = Point(*(x.reshape(shape + x.shape[1:]) for x in graded(case, values)))
    local = tuple(in_case_unit(value, x) for value, x in zip(selected, grid))
    rooms = distances(case, values).reshape(shape + values.shape[1:])
    endpoints = boundaries(rooms, local, space.required)
    return ProbabilityMap(space.axes, local, result, space.samples, tuple(endpoints))


def at_points(
    process: "PharmaProcess", changes: Sequence[Mapping[Entry, float]], samples: int, seed: int
) -> Point:
    """[n] probabilities at set points, which are moved by their `changes` in the domain's unit."""
    return graded(process.case, drawn_values(process, changes, samples, seed))


def drawn_values(
    process: "PharmaProcess", changes: Sequence[Mapping[Entry, float]], samples: int, seed: int
) -> np.ndarray:
    """[n, samples, Q] attributes of the same batches at every set point."""
    rows = np.concatenate([batches.drawn(process, item, samples, seed) for item in changes])
    return batches.attributes(process, rows).reshape(len(changes), samples, -1)


def graded(case: PharmaCase, values: np.ndarray) -> Point:
    """Counts over the draws of `values` [n, samples, Q]."""
    samples = values.shape[1]
    selected = AttributeLimits.of(case).hold(values)
    all_kept = selected.all(-1).mean(-1)
    broken = (~selected).sum(1)
    finite = np.asarray(np.isfinite(values).all(-1))
    total = np.where(finite[..., None], values, 0.0).sum(1)
    with np.errstate(invalid="ignore"):
        mean = total / finite.sum(1)[:, None]
    low, high = interval(all_kept, samples)
    return Point(
        probability=all_kept,
        error=proportion(samples * all_kept, samples)[1],
        by_attribute=selected.mean(1),
        mean=mean,
        binding=np.where(broken.max(-1) > 0, broken.argmax(-1), -1),
        failed=1 - finite.mean(1),
        low=low,
        high=high,
    )


def parameter(case: PharmaCase, name: str) -> Parameter:
    """The parameter with this name."""
    return next(item for item in case.parameters if item.name == name)


def in_case_unit(item: Parameter, value):
    """A number of the domain in the case's unit."""
    return (value - item.offset) / item.scale


@dataclass(frozen=True, eq=False)
class LargestBox:
    """A box inside the design space, from `low` to `high` [axes] in the case's units; `volume`: its
    share of the map."""

    low: Floats
    high: Floats
    volume: Number


def largest_box(
    result: ProbabilityMap, nominal: Sequence[float], required: float
) -> LargestBox | None:
    """The largest box between grid points that contains the set point and only good points.

    Exact search: every pair of grid points on each axis that encloses `nominal` (the case's units),
    points counted by a summed-area table. None if the set point's cell is not good.
    """
    invalid = np.pad(
        (result.at.probability < required).astype(np.int64), [(1, 0)] * len(result.axes)
    )
    for axis in range(invalid.ndim):
        invalid = invalid.cumsum(axis)
    pairs = []
    for grid, here in zip(result.grid, nominal):
        low = np.flatnonzero(grid <= here + 1e-9 * np.ptp(grid))
        high = np.flatnonzero(grid >= here - 1e-9 * np.ptp(grid))
        both = [(i, j) for i in low for j in high if i < j]
        pairs.append(np.array(both))
    count = _inside(invalid, pairs)
    sides = [grid[pair[:, 1]] - grid[pair[:, 0]] for grid, pair in zip(result.grid, pairs)]
    volume = np.ones(count.shape)
    for axis, (side, grid) in enumerate(zip(sides, result.grid)):
        shape = [1] * volume.ndim
        shape[axis] = len(side)
        volume = volume * (side / np.ptp(grid)).reshape(shape)
    volume = np.where(count == 0, volume, -1.0)
    best = np.unravel_index(int(volume.argmax()), volume.shape)
    if volume[best] < 0:
        return None
    endpoints = [pair[i] for pair, i in zip(pairs, best)]
    low = np.array([grid[end[0]] for grid, end in zip(result.grid, endpoints)])
    high = np.array([grid[end[1]] for grid, end in zip(result.grid, endpoints)])
    return LargestBox(low, high, float(volume[best]))


def _inside(summed: np.ndarray, pairs: list[np.ndarray]) -> np.ndarray:
    """[pairs of axis 0, pairs of axis 1, …] bad points in every box, both ends included."""
    for axis, pair in enumerate(pairs):
        upper = np.take(summed, pair[:, 1] + 1, axis)
        summed = upper - np.take(summed, pair[:, 0], axis)
    return summed
