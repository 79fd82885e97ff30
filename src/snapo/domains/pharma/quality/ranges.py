"""Proven acceptable ranges: the range of one parameter with all others at their set point.

There are two criteria: the nominal model, and a required probability under all variation. All edges
of all parameters are searched side by side, so that batches run together.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..flowsheet.case import PharmaCase
from ..given import Entry
from . import batches
from .batches import AttributeLimits
from .design_space import at_points, in_case_unit
from .records import Parameter

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

Changes = Mapping[Entry, float]  # of a set point, in the domain's unit


class GradedPoints(NamedTuple):
    """[n] whether points meet the criterion; the index of the worst attribute; whether they meet it
    even at the lower end, or only at the upper end, of the interval of their probability."""

    fine: np.ndarray
    fails: np.ndarray
    certain: np.ndarray
    possible: np.ndarray


Good = Callable[[Sequence[Changes]], GradedPoints]


def goods(process: "PharmaProcess", required: float, samples: int, seed: int) -> tuple[Good, Good]:
    """The two criteria: the limits hold for the nominal model; and they hold with the `required`
    probability over `samples` draws, in which a parameter with a distribution varies about its
    point."""
    case = process.case
    limits = AttributeLimits.of(case)
    margins = np.array([attribute.margin for attribute in case.attributes])

    def nominally(changes: Sequence[Changes]) -> GradedPoints:
        rows = [batches.nominally(process, item) for item in changes]
        values = batches.attributes(process, np.concatenate(rows))
        room = np.where(limits.any(), limits.distance(values), np.inf) / margins
        worst = np.argmin(np.nan_to_num(room, nan=-np.inf, posinf=np.inf), -1)
        fine = np.asarray(limits.hold(values).all(-1))
        return GradedPoints(fine, worst, fine, fine)

    def probably(changes: Sequence[Changes]) -> GradedPoints:
        points = at_points(process, changes, samples, seed)
        grades = (entry >= required for entry in (points.probability, points.low, points.high))
        fine, certain, possible = grades
        return GradedPoints(fine, points.binding, certain, possible)

    return nominally, probably


if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

NOMINAL = (17, 7, 3)  # points over the range, then within the bracket of an edge; repetitions
PROBABLE = (9, 3, 1)  # every point of these is many batches


@dataclass(frozen=True)
class AcceptableRange:
    """A range in the case's unit; an edge is the name of the attribute that fails beyond it.

    `low`, `high`: None if the set point itself fails. `low_edge`, `high_edge`: "" if the studied
    range ends before any limit. `certain`: the ends between which every tested point passes even at
    the lower end of its 95 % interval; `possible`: the same up to the first points that fail even
    at the upper end; None if the set point itself fails. `holds_normal`, `sure_normal`: whether the
    normal range lies inside, and inside `certain`.
    """

    low: float | None
    high: float | None
    low_edge: str
    high_edge: str
    holds_normal: bool
    certain: tuple[float, float] | None = None
    possible: tuple[float, float] | None = None
    sure_normal: bool = False


@dataclass(frozen=True)
class ProvenRange:
    """`nominal`: of the model at its nominal numbers; `probable`: with the `required` probability,
    estimated from `samples` draws."""

    parameter: str
    unit: str
    required: float
    samples: int
    nominal: AcceptableRange
    probable: AcceptableRange


RangePoints = list[tuple[Parameter, float]]  # [n] (parameter, value in the domain's unit)


def proven_ranges(
    process: "PharmaProcess", required: float, samples: int, seed: int
) -> list[ProvenRange]:
    """Both proven ranges of every parameter. A parameter with a distribution varies about each
    point of its probable range.
    """
    case: PharmaCase = process.case
    nominally, probably = goods(process, required, samples, seed)
    ranges = [
        _ranges(process, valid, search)
        for valid, search in ((nominally, NOMINAL), (probably, PROBABLE))
    ]
    return [
        ProvenRange(p.name, p.unit, required, samples, *both)
        for p, *both in zip(case.parameters, *ranges)
    ]


def changes(points: RangePoints) -> list[Changes]:
    """The points as changes of one number each."""
    return [{(p.input, p.entry): x} for p, x in points]


def set_point(process: "PharmaProcess", parameter: Parameter) -> float:
    """The parameter's set point in the domain's unit."""
    return float(process.inputs[parameter.input][parameter.entry])


class _Edge(NamedTuple):
    """An edge lies after `inner` and not after `outer`, where attribute `fails` violates one."""

    parameter: Parameter
    inner: float
    outer: float
    fails: int


def _ranges(
    process: "PharmaProcess", valid: Good, search: tuple[int, int, int]
) -> list[AcceptableRange]:
    case = process.case
    scans = []
    for selected in case.parameters:
        grid = np.linspace(selected.low, selected.high, search[0])
        scans.append(np.unique(np.append(grid, set_point(process, selected))))
    first = [(p, x) for p, scan in zip(case.parameters, scans) for x in scan]
    result = valid(changes(first))
    fine, fails, observed = result.fine, result.fails, _Seen()
    observed.add(first, result)
    edges: list[_Edge] = []
    start = 0
    for selected, scan in zip(case.parameters, scans):
        part = slice(start, start + len(scan))
        start += len(scan)
        here = int(np.flatnonzero(scan == set_point(process, selected))[0])
        for step in (-1, +1):
            edges.append(_bracket(selected, scan, fine[part], fails[part], here, step))
    for _ in range(search[2]):
        edges = _zoom(edges, valid, search[1], observed)
    names = [attribute.name for attribute in case.attributes]
    return [
        _range(
            choice, low, high, names, _reach(observed.of(choice.name), set_point(process, choice))
        )
        for choice, low, high in zip(case.parameters, edges[::2], edges[1::2])
    ]


class _Seen:
    """The evaluated points: {parameter: [(value, certain, possible)]}."""

    def __init__(self):
        self.points: dict[str, list[tuple[float, bool, bool]]] = {}

    def add(self, points: RangePoints, result: GradedPoints) -> None:
        for (selected, x), certain, possible in zip(points, result.certain, result.possible):
            self.points.setdefault(selected.name, []).append(
                (float(x), bool(certain), bool(possible))
            )

    def of(self, name: str) -> list[tuple[float, bool, bool]]:
        return sorted(self.points[name])


RangeEnds = tuple[float, float] | None


def _reach(points: list[tuple[float, bool, bool]], here: float) -> tuple[RangeEnds, RangeEnds]:
    """The certain range about the set point `here`, up to the last certain point; and the possible
    one, up to the first point that is not possible."""
    values = [x for x, *_ in points]
    at = values.index(here)

    def endpoints(grade: int, outside: int) -> RangeEnds:
        valid = [point[grade] for point in points]
        if not valid[at]:
            return None
        low, high = at, at
        while low > 0 and valid[low - 1]:
            low -= 1
        while high < len(valid) - 1 and valid[high + 1]:
            high += 1
        return values[max(0, low - outside)], values[min(len(values) - 1, high + outside)]

    return endpoints(1, 0), endpoints(2, 1)


def _bracket(selected, scan, fine, fails, here: int, step: int) -> _Edge:
    """The first failure in one direction from the set point; NaN if the set point itself fails."""
    if not fine[here]:
        return _Edge(selected, float("nan"), float("nan"), int(fails[here]))
    end = here
    while 0 <= end + step < len(scan) and fine[end + step]:
        end += step
    if not 0 <= end + step < len(scan):
        return _Edge(selected, float(scan[end]), float(scan[end]), -1)
    return _Edge(selected, float(scan[end]), float(scan[end + step]), int(fails[end + step]))


def _zoom(edges: list[_Edge], valid: Good, count: int, observed: _Seen) -> list[_Edge]:
    """The brackets, narrowed by `count` points within each of them."""
    open_ones = [i for i, edge in enumerate(edges) if edge.fails >= 0 and edge.inner == edge.inner]
    if not open_ones:
        return edges
    inside = [np.linspace(edges[i].inner, edges[i].outer, count + 2)[1:-1] for i in open_ones]
    requested = [(edges[i].parameter, x) for i, xs in zip(open_ones, inside) for x in xs]
    looked = valid(changes(requested))
    fine, fails = looked.fine, looked.fails
    observed.add(requested, looked)
    zoom = list(edges)
    for k, (i, points) in enumerate(zip(open_ones, inside)):
        part = slice(k * count, (k + 1) * count)
        broken = np.flatnonzero(~fine[part])
        first = int(broken[0]) if len(broken) else count
        complete = [edges[i].inner, *points.tolist(), edges[i].outer]
        fault = int(fails[part][first]) if first < count else edges[i].fails
        zoom[i] = _Edge(edges[i].parameter, complete[first], complete[first + 1], fault)
    return zoom


def _range(
    parameter: Parameter,
    low: _Edge,
    high: _Edge,
    names: list[str],
    reach: tuple[RangeEnds, RangeEnds],
) -> AcceptableRange:
    below, above = ("" if edge.fails < 0 else names[edge.fails] for edge in (low, high))
    if low.inner != low.inner:
        return AcceptableRange(None, None, below, above, False)
    inside = low.inner <= parameter.normal_low and high.inner >= parameter.normal_high
    start, end = (float(in_case_unit(parameter, edge.inner)) for edge in (low, high))
    certain, possible = (
        None
        if endpoints is None
        else (
            float(in_case_unit(parameter, endpoints[0])),
            float(in_case_unit(parameter, endpoints[1])),
        )
        for endpoints in reach
    )
    first = reach[0]
    firmly = first is not None and (
        first[0] <= parameter.normal_low and first[1] >= parameter.normal_high
    )
    return AcceptableRange(start, end, below, above, inside, certain, possible, firmly)
