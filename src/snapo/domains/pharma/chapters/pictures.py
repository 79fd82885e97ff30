"""Charts of a process: heat map, tornado, curves over time, the plane of a crystallisation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.report.drawing import LIGHT, legend_above, number_axis, unit_above
from snapo.report.quantity import number, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVES = ("inject", "withdraw", "good", "limit", "main", "other")
STYLES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), "-", (0, (3, 1)))
STRONGEST = 0.62  # opacity of the deepest cell: text stays readable on it


def heat(
    axes: "Axes",
    values: np.ndarray,
    texts: Sequence[Sequence[str]],
    rows,
    columns,
    full: np.ndarray,
) -> None:
    """Cells coloured by sign and size, each with its number; `full` is the size with the deepest
    colour in each row."""
    from matplotlib.patches import Rectangle

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


def tornado(axes: "Axes", names: Sequence[str], values: np.ndarray, unit: str) -> None:
    """Bars to both sides, the longest on top: the effect of each parameter over its normal range.

    Lengths are shares of the longest bar, so that panels of different units share an axis.
    """
    from matplotlib.ticker import NullLocator

    order = np.argsort(-np.abs(values), kind="stable")
    share = values / (np.abs(values).max() or 1.0)
    for row, i in enumerate(order):
        size = abs(float(share[i]))
        axes.barh(row, 2 * size, left=-size, height=0.62, color=LIGHT["main-soft"])
        axes.plot([share[i]] * 2, [row - 0.31, row + 0.31], color=LIGHT["main"], linewidth=2.4)
        text = number(abs(values[i])) if values[i] else "0"
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
    axes: "Axes", x: np.ndarray, lines: Sequence[tuple[str, np.ndarray]], unit: str, zero=False
) -> None:
    """Named lines over one axis, distinguished by colour and by dashes."""
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


def minutes_below(*panels: "Axes") -> None:
    """Labels for the time under every panel; panels that share an axis would show it only under the
    last."""

    for axes in panels:
        axes.tick_params(axis="x", labelbottom=True)
        axes.set_xlabel("Time, min")


def plane(axes: "Axes", temperature, concentration, curve: tuple[np.ndarray, np.ndarray]) -> None:
    """The path of a batch through the c-T plane, above its solubility; time runs to the left."""
    axes.plot(*curve, color=LIGHT["limit"], linestyle=(0, (5, 2)), label="Solubility")
    axes.plot(temperature, concentration, color=LIGHT["main"], linewidth=2.0, label="Batch")
    axes.plot(temperature[0], concentration[0], "o", color=LIGHT["main"], label="Start")
    axes.set_xlabel("Temperature, K")
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 6)
    unit_above(axes, "Dissolved, kg/m³")
    legend_above(axes)


def residuals(axes: "Axes", shares: np.ndarray) -> None:
    """Points in their order, with the band from -1 to 1."""
    axes.axhspan(-1, 1, color=LIGHT["inject-soft"], linewidth=0)
    axes.plot(np.arange(1, len(shares) + 1), shares, "o", color=LIGHT["main"], markersize=4)
    axes.set_xlabel("Measurement")
    number_axis(axes.yaxis, 6)


def agreement(axes: "Axes", measured: np.ndarray, fit: np.ndarray, unit: str) -> None:
    """Fitted against measured values, with the line on which both agree."""
    endpoints = [min(measured.min(), fit.min()), max(measured.max(), fit.max())]
    axes.plot(endpoints, endpoints, color=LIGHT["other"], linewidth=0.9, label="Agreement")
    axes.plot(measured, fit, "o", color=LIGHT["main"], markersize=4, label="Measurements")
    axes.set_xlabel(with_unit("Measured", unit))
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 6)
    unit_above(axes, with_unit("Fitted", unit))
    legend_above(axes)
