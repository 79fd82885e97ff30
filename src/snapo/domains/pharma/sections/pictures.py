"""Charts of a process: heat map, tornado, profile with sensitivities, design space."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import NullLocator

from snapo.report.axes import number_axis
from snapo.report.drawing import legend_above, unit_above
from snapo.report.quantity import number, with_unit
from snapo.report.theme import LIGHT

CURVES = ("inject", "withdraw", "good", "limit", "main", "other")
STYLES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), "-", (0, (3, 1)))
STRONGEST = 0.62  # opacity of the deepest cell: text stays readable on it


def heat(
    axes: Axes, values: np.ndarray, texts: Sequence[Sequence[str]], rows, columns, full: np.ndarray
) -> None:
    """Cells coloured by sign and size, each with its number; `full` is each row's deepest size."""
    for q in range(len(rows)):
        for p in range(len(columns)):
            size = abs(values[q, p]) / full[q] if full[q] > 0 else 0.0
            colour = LIGHT["withdraw" if values[q, p] > 0 else "inject"]
            depth = STRONGEST * min(size, 1.0) if np.isfinite(size) else STRONGEST
            axes.add_patch(Rectangle((p, q), 1, 1, facecolor=colour, alpha=depth, linewidth=0))
            axes.text(p + 0.5, q + 0.5, texts[q][p], ha="center", va="center", color=LIGHT["ink"])
    axes.set_xlim(0, len(columns))
    axes.set_ylim(len(rows), 0)
    axes.set_xticks(np.arange(len(columns)) + 0.5, columns)
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows)
    axes.xaxis.tick_top()
    axes.tick_params(axis="both", length=0, labelcolor=LIGHT["ink"])
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    for k in range(len(rows) + 1):
        axes.axhline(k, color=LIGHT["rule"], linewidth=0.7)


def tornado(axes: Axes, names: Sequence[str], values: np.ndarray, unit: str) -> None:
    """Bars to both sides, the longest on top: the effect of each parameter over its normal range.

    Lengths are shares of the longest bar, so that panels of different units share an axis.
    """
    order = np.argsort(-np.abs(values), kind="stable")
    share = values / (np.abs(values).max() or 1.0)
    for row, i in enumerate(order):
        size = abs(float(share[i]))
        axes.barh(row, 2 * size, left=-size, height=0.62, color=LIGHT["main-soft"])
        axes.plot([share[i]] * 2, [row - 0.31, row + 0.31], color=LIGHT["main"], linewidth=2.4)
        text = f"± {number(abs(values[i]))}" if values[i] else "0"
        axes.text(size + 0.02, row, text, va="center")
    axes.set_yticks(range(len(order)), [names[int(i)] for i in order])
    axes.tick_params(axis="y", length=0, labelcolor=LIGHT["ink"])
    axes.set_ylim(len(order) - 0.45, -0.55)
    axes.set_xlim(-1.05, 1.4)
    axes.xaxis.set_major_locator(NullLocator())
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    axes.axvline(0.0, color=LIGHT["other"], linewidth=0.8)
    axes.set_title(unit, loc="left", pad=4, color=LIGHT["ink"])


def curves(
    axes: Axes, x: np.ndarray, lines: Sequence[tuple[str, np.ndarray]], unit: str, zero=False
) -> None:
    """Named lines over one axis, told apart by colour and by dashes."""
    for i, (name, values) in enumerate(lines):
        style = {"color": LIGHT[CURVES[i % len(CURVES)]], "linestyle": STYLES[i % len(STYLES)]}
        axes.plot(x, values, label=name, **style)
    if zero:
        axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
    axes.set_xlim(x[0], x[-1])
    number_axis(axes.yaxis, 5)
    unit_above(axes, unit)
    if len(lines) > 1:
        legend_above(axes)


def minutes_below(*panels: Axes) -> None:
    """The time under every panel: those that share an axis show it under the last alone."""
    for axes in panels:
        axes.tick_params(axis="x", labelbottom=True)
        axes.set_xlabel("Time, min")


def plane(axes: Axes, temperature, concentration, curve: tuple[np.ndarray, np.ndarray]) -> None:
    """The way of a batch through the c-T plane, above its solubility; time runs to the left."""
    axes.plot(*curve, color=LIGHT["limit"], linestyle=(0, (5, 2)), label="Solubility")
    axes.plot(temperature, concentration, color=LIGHT["main"], linewidth=2.0, label="Batch")
    axes.plot(temperature[0], concentration[0], "o", color=LIGHT["main"], label="Start")
    axes.set_xlabel("Temperature, K")
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 6)
    unit_above(axes, "Dissolved, kg/m³")
    legend_above(axes)


def space(
    axes: Axes,
    found: dict[str, Any],
    probability: np.ndarray,
    names,
    band: tuple[np.ndarray, np.ndarray],
) -> None:
    """Probability of all limits over two parameters: contours, set point, boxes; dotted, where the
    lower and the upper ends `band` of its interval reach what is required."""
    x, y = (np.asarray(grid) for grid in found["grid"][:2])
    levels = sorted({0.5, *found["levels"], found["required"]})
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
        if end.min() < found["required"] < end.max():
            axes.contour(x, y, end.T, levels=[found["required"]], colors=LIGHT["good"],
                         linestyles="dotted", linewidths=1.6)  # fmt: skip
    _boxes(axes, found)
    axes.set_xlabel(with_unit(names[0], found["units"][0]))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 8)
    axes.grid(False)
    unit_above(axes, with_unit(names[1], found["units"][1]))
    legend_above(axes)


def _labels(axes: Axes, drawn: Any) -> None:
    """The level of each contour where the other labels are farthest away, off the edges."""
    x, y = (np.array(ends) for ends in (axes.get_xlim(), axes.get_ylim()))
    corner, size = np.array([x[0], y[0]]), np.array([np.ptp(x), np.ptp(y)])
    taken: list[np.ndarray] = []
    for lines in drawn.allsegs:
        points = np.concatenate([_along((each - corner) / size) for each in lines])
        inner = points[((points > 0.06) & (points < 0.94)).all(1)]
        points = inner if len(inner) else points
        others = np.array(taken or [[0.5, 0.5]])
        away = np.linalg.norm(points[:, None] - others, axis=-1).min(1)
        taken.append(points[int(away.argmax() if taken else away.argmin())])
    axes.clabel(drawn, fmt=lambda value: f"{value:g}", fontsize=8,
                manual=[tuple(corner + each * size) for each in taken])  # fmt: skip


def _along(line: np.ndarray, parts: int = 8) -> np.ndarray:
    """Points on a broken line [n, 2], some between every two of its corners."""
    share = np.arange(parts)[:, None] / parts
    between = line[:-1, None] + share * (line[1:] - line[:-1])[:, None]
    return np.concatenate([between.reshape(-1, 2), line[-1:]])


def _boxes(axes: Axes, found: dict[str, Any]) -> None:
    """Set point, normal operating range, and the largest box of the required probability."""
    (left, right), (low, high) = found["normal"][:2]
    style: dict[str, Any] = {"fill": False, "linewidth": 1.4}
    axes.add_patch(Rectangle((left, low), right - left, high - low, edgecolor=LIGHT["ink"],
                             label="Normal range", **style))  # fmt: skip
    box = found.get("box")
    if box:
        (left, low), (right, high) = box["low"][:2], box["high"][:2]
        style |= {"linestyle": (0, (5, 2)), "edgecolor": LIGHT["good"], "label": "Largest box"}
        axes.add_patch(Rectangle((left, low), right - left, high - low, **style))
    here = found["nominal"]
    axes.plot(here[0], here[1], "o", color=LIGHT["ink"], markersize=6, label="Set point")


def binding(axes: Axes, found: dict[str, Any], which: np.ndarray, names, attributes) -> None:
    """Which attribute most often breaks its limits at each point; a dot where none does."""
    x, y = (np.asarray(grid) for grid in found["grid"][:2])
    marks = "osD^vP"
    for i in np.unique(which):
        row, column = np.nonzero(which == i)
        if i < 0:
            axes.plot(x[row], y[column], ".", color=LIGHT["other"], label="None", markersize=3,
                      clip_on=False)  # fmt: skip
            continue
        style: Any = {"color": LIGHT[CURVES[int(i) % len(CURVES)]], "linestyle": "none"}
        axes.plot(x[row], y[column], marker=marks[int(i) % len(marks)], label=attributes[int(i)],
                  markersize=5, clip_on=False, **style)  # fmt: skip
    axes.set_xlabel(with_unit(names[0], found["units"][0]))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 8)
    axes.tick_params(axis="y", pad=7)  # off the marks on the edge
    axes.grid(False)
    unit_above(axes, with_unit(names[1], found["units"][1]))
    legend_above(axes)


def residuals(axes: Axes, shares: np.ndarray) -> None:
    """Points in their order, with the band from -1 to 1."""
    axes.axhspan(-1, 1, color=LIGHT["inject-soft"], linewidth=0)
    axes.plot(np.arange(1, len(shares) + 1), shares, "o", color=LIGHT["main"], markersize=4)
    axes.set_xlabel("Measurement")
    number_axis(axes.yaxis, 6)


def agreement(axes: Axes, measured: np.ndarray, fitted: np.ndarray, unit: str) -> None:
    """Fitted over measured, with the line on which both agree."""
    ends = [min(measured.min(), fitted.min()), max(measured.max(), fitted.max())]
    axes.plot(ends, ends, color=LIGHT["other"], linewidth=0.9, label="Agreement")
    axes.plot(measured, fitted, "o", color=LIGHT["main"], markersize=4, label="Measurements")
    axes.set_xlabel(with_unit("Measured", unit))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 6)
    unit_above(axes, with_unit("Fitted", unit))
    legend_above(axes)
