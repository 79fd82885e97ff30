"""Proven acceptable ranges: how far one parameter may move with all others at their set point.

All edges of all parameters are searched side by side, so that batches run together.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from . import batches
from .design_space import at_points, owners
from .limits import Limits
from .records import Parameter

if TYPE_CHECKING:
    from ..flowsheet.process import Process

NOMINAL = (17, 7, 3)  # points over the range, then within the bracket of an edge, so many times
PROBABLE = (9, 3, 1)  # every point of these is many batches


class Range(NamedTuple):
    """A range in the owner's unit; an edge names the attribute that fails beyond it.

    `low`, `high`: None where the set point itself does not do. `low_edge`, `high_edge`: "" where
    the studied range ends before any limit. `holds_normal`: whether the normal range lies inside.
    """

    low: float | None
    high: float | None
    low_edge: str
    high_edge: str
    holds_normal: bool


class Proven(NamedTuple):
    """`nominal`: of the model at its nominal numbers; `probable`: with the required probability."""

    parameter: str
    unit: str
    nominal: Range
    probable: Range


# [n] (parameter, value in the domain's unit) -> [n] whether they do, [n] the attribute that fails.
Points = list[tuple[Parameter, float]]
Good = Callable[[Points], tuple[np.ndarray, np.ndarray]]


def proven_ranges(process: "Process", required: float, samples: int, seed: int) -> list[Proven]:
    """Both ranges of every parameter.

    A parameter with a distribution varies about each point of its probable range.
    """
    case: PharmaCase = process.case
    limits = Limits.of(case)
    margins = np.array([each.margin for each in case.attributes])

    def nominally(points: Points):
        rows = [batches.nominally(process, {(p.input, p.entry): x}) for p, x in points]
        values = batches.attributes(process, np.concatenate(rows))
        room = np.where(limits.any(), limits.distance(values), np.inf) / margins
        worst = np.argmin(np.nan_to_num(room, nan=-np.inf, posinf=np.inf), -1)
        return np.asarray(limits.hold(values).all(-1)), worst

    def probably(points: Points):
        found = at_points(process, [{(p.input, p.entry): x} for p, x in points], samples, seed)
        return found.probability >= required, found.binding

    found = [
        _ranges(process, good, search)
        for good, search in ((nominally, NOMINAL), (probably, PROBABLE))
    ]
    return [Proven(p.name, p.unit, *each) for p, *each in zip(case.parameters, *found)]


def set_point(process: "Process", chosen: Parameter) -> float:
    """The parameter's set point in the domain's unit."""
    return float(process.inputs[chosen.input][chosen.entry])


class _Edge(NamedTuple):
    """An edge lies after `inner` and not after `outer`, where attribute `fails` breaks a limit."""

    chosen: Parameter
    inner: float
    outer: float
    fails: int


def _ranges(process: "Process", good: Good, search: tuple[int, int, int]) -> list[Range]:
    case = process.case
    scans = []
    for chosen in case.parameters:
        grid = np.linspace(chosen.low, chosen.high, search[0])
        scans.append(np.unique(np.append(grid, set_point(process, chosen))))
    fine, fails = good([(p, x) for p, scan in zip(case.parameters, scans) for x in scan])
    edges: list[_Edge] = []
    start = 0
    for chosen, scan in zip(case.parameters, scans):
        part = slice(start, start + len(scan))
        start += len(scan)
        here = int(np.flatnonzero(scan == set_point(process, chosen))[0])
        for step in (-1, +1):
            edges.append(_bracket(chosen, scan, fine[part], fails[part], here, step))
    for _ in range(search[2]):
        edges = _zoom(edges, good, search[1])
    names = [each.name for each in case.attributes]
    return [
        _range(chosen, low, high, names)
        for chosen, low, high in zip(case.parameters, edges[::2], edges[1::2])
    ]


def _bracket(chosen, scan, fine, fails, here: int, step: int) -> _Edge:
    """The first failure seen from the set point; not a number where that fails itself."""
    if not fine[here]:
        return _Edge(chosen, float("nan"), float("nan"), int(fails[here]))
    end = here
    while 0 <= end + step < len(scan) and fine[end + step]:
        end += step
    if not 0 <= end + step < len(scan):
        return _Edge(chosen, float(scan[end]), float(scan[end]), -1)
    return _Edge(chosen, float(scan[end]), float(scan[end + step]), int(fails[end + step]))


def _zoom(edges: list[_Edge], good: Good, count: int) -> list[_Edge]:
    """Every bracket made smaller by `count` points within it."""
    open_ones = [i for i, edge in enumerate(edges) if edge.fails >= 0 and edge.inner == edge.inner]
    if not open_ones:
        return edges
    inside = [np.linspace(edges[i].inner, edges[i].outer, count + 2)[1:-1] for i in open_ones]
    fine, fails = good([(edges[i].chosen, x) for i, xs in zip(open_ones, inside) for x in xs])
    found = list(edges)
    for k, (i, points) in enumerate(zip(open_ones, inside)):
        part = slice(k * count, (k + 1) * count)
        broken = np.flatnonzero(~fine[part])
        first = int(broken[0]) if len(broken) else count
        whole = [edges[i].inner, *points.tolist(), edges[i].outer]
        fault = int(fails[part][first]) if first < count else edges[i].fails
        found[i] = _Edge(edges[i].chosen, whole[first], whole[first + 1], fault)
    return found


def _range(chosen: Parameter, low: _Edge, high: _Edge, names: list[str]) -> Range:
    below, above = ("" if edge.fails < 0 else names[edge.fails] for edge in (low, high))
    if low.inner != low.inner:
        return Range(None, None, below, above, False)
    inside = low.inner <= chosen.normal_low and high.inner >= chosen.normal_high
    start, end = (float(owners(chosen, edge.inner)) for edge in (low, high))
    return Range(start, end, below, above, inside)
