"""The design space: the map, the largest box inside, and the boundary of the space."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.report.drawing import LIGHT, draw, legend_above, number_axis, unit_above
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Table, Text
from snapo.report.quantity import finite, number, percent, plus_minus, quantity, with_unit
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import StudyRun

from ..flowsheet.process import PharmaProcess
from ..quality import design_space, ranges
from ..quality.boundary import Boundary, draws_for
from ..quality.design_space import LargestBox, in_case_unit
from ..shared import MESH, open_loop, sampled
from . import pictures
from .model import location, stated

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAP, ENDS = "design_space.csv", "design_space_boundary.csv"


@dataclass(frozen=True, eq=False)
class SpaceMap:
    """The map over two or three parameters, in the case's units.

    - `axes`, `units`, `grid`: name, unit and grid points of each axis; `nominal`: its set point;
      `normal`: its normal range.
    - The fields of `quality.design_space.Point` at every point of the map; `samples`: the draws at
      a point.
    - `levels`: the probabilities of the contours; `required`: the required probability. `box`: the
      largest box inside the space, None if the set point itself is outside. `ends`: the boundary of
      the space along the lines of the map.
    """

    axes: tuple[str, ...]
    units: tuple[str, ...]
    grid: tuple[Floats, ...]
    probability: Floats
    error: Floats
    each: Floats
    mean: Floats
    binding: Floats
    failed: Floats
    low: Floats
    high: Floats
    samples: int
    levels: tuple[Number, ...]
    required: Number
    nominal: tuple[Number, ...]
    normal: tuple[tuple[Number, Number], ...]
    box: LargestBox | None
    ends: tuple[Boundary, ...] | None = None

    @property
    def headers(self) -> list[str]:
        """The axes with their units, for the header of a file."""
        return [f"{name} [{unit}]" for name, unit in zip(self.axes, self.units)]


def measure(run: StudyRun) -> SpaceMap:
    """The map and its ends, which are also separate tables."""
    result, loop = space_map(sampled(run), open_loop(run).seed), open_loop(run)
    names = [attribute.name for attribute in loop.case.attributes]
    run.write_csv(MAP, *map_rows(result, names))
    run.write_csv(ENDS, *boundary_rows(result, names))
    return result


def space_map(process: PharmaProcess, seed: int) -> SpaceMap:
    """The map, its sampling error and binding attribute, and the largest box inside."""
    case = process.case
    result = design_space.probability_map(process, seed)
    space = case.design_space
    assert space is not None
    axes = [design_space.parameter(case, name) for name in space.axes]
    here = [float(in_case_unit(p, ranges.set_point(process, p))) for p in axes]
    point = result.at._asdict()
    return SpaceMap(
        axes=tuple(result.axes), units=tuple(p.unit for p in axes), grid=tuple(result.grid),
        each=point.pop("by_attribute"), **point, samples=result.samples, levels=tuple(space.levels),
        required=space.required, nominal=tuple(here),
        normal=tuple((in_case_unit(p, p.normal_low), in_case_unit(p, p.normal_high)) for p in axes),
        box=design_space.largest_box(result, here, space.required), ends=tuple(result.boundaries),
    )  # fmt: skip


def map_rows(
    result: SpaceMap, attributes: Sequence[str]
) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `design_space.csv`: one row per point of the map."""
    grid = [_rounded(x.ravel()) for x in np.meshgrid(*result.grid, indexing="ij")]
    numbers = (result.probability, result.error, result.low, result.high)
    columns = [x.tolist() for x in (*grid, *map(np.ravel, numbers))]
    binding = np.ravel(result.binding).astype(int).tolist()
    which = [attributes[i] if i >= 0 else "" for i in binding]
    names = ("probability", "standard_error", "low", "high", "binding")
    return (*result.headers, *names), zip(*columns, which)


def _rounded(digits) -> np.ndarray:
    """Positions on the axes of the map to ten significant digits, which removes round-off."""
    return np.array([float(f"{x:.10g}") for x in digits])


def boundary_rows(
    result: SpaceMap, attributes: Sequence[str]
) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `design_space_boundary.csv`: one row for every end of the space."""
    names, rows = result.headers, []
    for end in result.ends or ():
        at = [grid[i] if i >= 0 else end.position for grid, i in zip(result.grid, end.at)]
        side = "above" if end.side > 0 else "below"
        numbers = _rounded((*at, end.position, end.inner, end.outer)).tolist()
        at, numbers = numbers[: len(at)], numbers[len(at) :]
        rows.append((*at, names[end.axis], side, *numbers, attributes[end.binding]))
    return (*names, "along", "ends", "boundary", "inner", "outer", "binding"), rows


def show(run: RunFiles, result: SpaceMap) -> list[Block]:
    """The probability of meeting all limits over the axes, and the attribute that fails first."""
    names = stated(run).attribute_names
    blocks: list[Block] = [_in_words(result)]
    blocks += [_map(result, at, position, names) for at, position in _slices(result)]
    return [*blocks, *boundary(result, names)]


def _slices(result: SpaceMap) -> list[tuple[Any, str]]:
    """The slices of a map with a third axis: at both ends and in the middle of this axis."""
    if result.probability.ndim == 2:
        return [(slice(None), "")]
    grid, name, unit = result.grid[2], result.axes[2], result.units[2]
    displayed = sorted({0, len(grid) // 2, len(grid) - 1})
    return [((slice(None), slice(None), k), f"{name} {quantity(grid[k], unit)}") for k in displayed]


def _in_words(result: SpaceMap) -> Text:
    share, certain = (
        float((x >= result.required).mean()) for x in (result.probability, result.low)
    )
    widest = plus_minus(100 * result.error.max(), 1)
    text = (
        f"At {percent(share, 0)} of the points of the map all limits hold with a probability of "
        f"{number(result.required)} or more. Every point has {number(result.samples, 0)} batches, "
        f"with the same draws at every point. The probability is uncertain by at most {widest} "
        f"(95 %). At {percent(certain, 0)} of the points, within the dotted line of the map, even "
        "the lower end of its 95 % interval is as high as required."
    )
    few = [level for level in result.levels if result.samples < draws_for(level)]
    if few:
        needed = " and ".join(
            f"{number(draws_for(level), 0)} draws for the contour at {level:g}" for level in few
        )
        text += (
            f" With so few draws not every contour can be certain: at least {needed} "
            "are needed at every point, all of them within the limits."
        )
    if result.box is None:
        return Text(text + " No box around the set point has the required probability.")
    sides = [
        f"{name} {location(low)} to {location(high, unit)}"
        for name, unit, low, high in zip(result.axes, result.units, result.box.low, result.box.high)
    ]
    return Text(f"{text} The largest box inside: {', '.join(sides)}.")


def _map(result: SpaceMap, at: Any, position: str, names: list[str]) -> Chart:
    """A slice `at` of the map; `position`: the position of a third axis, as text."""

    def paint(upper, lower):
        _contours(upper, result, result.probability[at], (result.low[at], result.high[at]))
        upper.set_xlabel("")  # the axis below has the same name, and its numbers
        _binding(lower, result, result.binding[at].astype(int), names)

    key = position.replace(" ", "").replace(".", "-").replace("\N{NO-BREAK SPACE}", "")
    svg = draw(f"space{key}", "Probability that all limits are met, with contours; below, the "
               "attribute that most often breaks its limits.", paint, 560, (1.2, 1.0))  # fmt: skip
    where = f" at {position}" if position else ""
    caption = (
        f"Above: probability that a batch meets all limits{where}, with its contours (darker is "
        "better); at 95 % the boundary of the required probability lies between the dotted lines: "
        "all points within the inner line have this probability, none outside the outer one. "
        "Below: the attribute that most often breaks its limits."
    )
    return Chart(svg, caption)


def boundary(result: SpaceMap, names: list[str]) -> list[Block]:
    """The ends of the space along the lines of the map that are nearest to the set point."""
    if result.ends is None:
        return []
    near = [int(np.abs(grid - here).argmin()) for grid, here in zip(result.grid, result.nominal)]
    rows = [
        _end(result, end, near, names)
        for end in result.ends
        if all(i in (-1, k) for i, k in zip(end.at, near))
    ]
    required = number(result.required)
    if not rows:
        text = (
            "On the lines of the map next to the set point the probability does not cross "
            f"{required}: the space contains all or none of the studied ranges there."
        )
        return [Text(text + f" {ENDS} has the other lines." * bool(result.ends))]
    head = ("Along", "At", "Ends", "Limit broken beyond", "Boundary", "95 % interval")
    text = (
        f"A boundary is the position at which the probability falls below {required} along a line "
        f"of the map next to the set point. Its 95 % interval is for {number(result.samples, 0)} "
        "batches per point (Wilson's interval of the share, inverted); “beyond” means that the "
        f"batches do not determine this end, or that the line ends first. {ENDS} has all lines."
    )
    table = Table([(name, "") for name in head], rows, "Where the design space ends", 4)
    return [table, Text(text, True)]


def _end(result: SpaceMap, end: Boundary, near: list[int], names: list[str]) -> tuple:
    """One row: an end of the space along a line through the grid point `near` the set point."""
    axis, span = end.axis, [finite(end.inner), finite(end.outer)]
    others = [
        f"{name} {location(grid[k], unit)}"
        for j, (name, unit, grid, k) in enumerate(zip(result.axes, result.units, result.grid, near))
        if j != axis
    ]
    if end.side < 0:
        span.reverse()
    return (
        with_unit(result.axes[axis], result.units[axis]), ", ".join(others),
        "above" if end.side > 0 else "below", names[end.binding], location(end.position),
        " – ".join("beyond" if x is None else location(x) for x in span),
    )  # fmt: skip


def _contours(
    axes: "Axes",
    result: SpaceMap,
    probability: np.ndarray,
    band: tuple[np.ndarray, np.ndarray],
) -> None:
    """Probability of all limits over two parameters: contours, set point, boxes; dotted, where the
    lower and the upper ends `band` of its interval equal the required probability."""
    x, y = result.grid[:2]
    levels = sorted({0.5, *result.levels, result.required})
    shades = ["panel", "reach", "main-soft", "inject-soft", "inject"]
    fill = [-0.001, *levels, 1.001]
    picked = [LIGHT[shades[min(i, len(shades) - 1)]] for i in range(len(fill) - 1)]
    axes.contourf(x, y, probability.T, levels=fill, colors=picked)
    if np.ptp(probability) > 0:
        inside = [k for k in levels if probability.min() < k < probability.max()]
        if inside:
            drawn = axes.contour(x, y, probability.T, levels=inside, colors=LIGHT["ink"],
                                 linewidths=0.9)  # fmt: skip
            _labels(axes, drawn)
    for end in band:
        if end.min() < result.required < end.max():
            axes.contour(x, y, end.T, levels=[result.required], colors=LIGHT["good"],
                         linestyles="dotted", linewidths=1.6)  # fmt: skip
    _boxes(axes, result)
    axes.set_xlabel(with_unit(result.axes[0], result.units[0]))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 8)
    axes.grid(False)
    unit_above(axes, with_unit(result.axes[1], result.units[1]))
    legend_above(axes)


def _labels(axes: "Axes", drawn: Any) -> None:
    """Labels with the level of each contour, far from the other labels and from the edges."""
    x, y = (np.array(endpoints) for endpoints in (axes.get_xlim(), axes.get_ylim()))
    corner, size = np.array([x[0], y[0]]), np.array([np.ptp(x), np.ptp(y)])
    taken: list[np.ndarray] = []
    for lines in drawn.allsegs:
        points = np.concatenate([_along((line - corner) / size) for line in lines])
        inner = points[((points > 0.06) & (points < 0.94)).all(1)]
        points = inner if len(inner) else points
        others = np.array(taken or [[0.5, 0.5]])
        away = np.linalg.norm(points[:, None] - others, axis=-1).min(1)
        taken.append(points[int(away.argmax() if taken else away.argmin())])
    axes.clabel(drawn, fmt=lambda value: f"{value:g}", fontsize=8,
                manual=[tuple(corner + item * size) for item in taken])  # fmt: skip


def _along(line: np.ndarray, parts: int = 8) -> np.ndarray:
    """Points on a broken line [n, 2], some between every two of its corners."""
    share = np.arange(parts)[:, None] / parts
    between = line[:-1, None] + share * (line[1:] - line[:-1])[:, None]
    return np.concatenate([between.reshape(-1, 2), line[-1:]])


def _boxes(axes: "Axes", result: SpaceMap) -> None:
    """Set point, normal operating range, and the largest box of the required probability."""
    from matplotlib.patches import Rectangle

    (left, right), (low, high) = result.normal[:2]
    style: dict[str, Any] = {"fill": False, "linewidth": 1.4}
    axes.add_patch(Rectangle((left, low), right - left, high - low, edgecolor=LIGHT["ink"],
                             label="Normal range", **style))  # fmt: skip
    if result.box is not None:
        (left, low), (right, high) = result.box.low[:2], result.box.high[:2]
        style |= {"linestyle": (0, (5, 2)), "edgecolor": LIGHT["good"], "label": "Largest box"}
        axes.add_patch(Rectangle((left, low), right - left, high - low, **style))
    here = result.nominal
    axes.plot(here[0], here[1], "o", color=LIGHT["ink"], markersize=6, label="Set point")


def _binding(axes: "Axes", result: SpaceMap, which: np.ndarray, attributes) -> None:
    """The attribute that most often violates its limits at each point; a dot if none does."""
    x, y = result.grid[:2]
    marks = "osD^vP"
    for i in np.unique(which):
        row, column = np.nonzero(which == i)
        if i < 0:
            axes.plot(x[row], y[column], ".", color=LIGHT["other"], label="None", markersize=3,
                      clip_on=False)  # fmt: skip
            continue
        style: Any = {
            "color": LIGHT[pictures.CURVES[int(i) % len(pictures.CURVES)]],
            "linestyle": "none",
        }
        axes.plot(x[row], y[column], marker=marks[int(i) % len(marks)], label=attributes[int(i)],
                  markersize=5, clip_on=False, **style)  # fmt: skip
    axes.set_xlabel(with_unit(result.axes[0], result.units[0]))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 8)
    axes.tick_params(axis="y", pad=7)  # off the marks on the edge
    axes.grid(False)
    unit_above(axes, with_unit(result.axes[1], result.units[1]))
    legend_above(axes)


SPACE = Chapter(
    "design space", "Design space", SpaceMap, measure, show, needs=(MESH,), key="design_space",
    table="design_space"
)  # fmt: skip
