"""Charts of distributions over time, of policies as a function of two numbers, and of risks side by
side."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .drawing import DARKEST, LIGHT, WIDTH, date_axis, legend_above, number_axis, unit_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LETTER, LINE = 5.4, 11.5  # points: a letter and a line of text of 9 points
GAP = 0.015  # between a bar and its number, as a share of the longest bar


def quantile_fan(
    axes: "Axes",
    years: np.ndarray,
    fan: Mapping[str, np.ndarray],
    unit: str,
    level: float | None,
    across: str = "Year",
    dates: Literal["", "day", "hour"] = "",
) -> None:
    """Bands of quantiles over years: 1-99, 5-95 and 25-75 %, the median and the mean.

    `fan`: {"p01": [n], …, "mean": [n]}; `level`: a value at which a line is drawn; `across`: the
    name of the horizontal axis if it does not show years; `dates`: the dates of the steps, for a
    date axis.
    """
    for low, high, alpha, name in (
        ("p01", "p99", 0.14, "1–99 %"),
        ("p05", "p95", 0.22, "5–95 %"),
        ("p25", "p75", 0.32, "25–75 %"),
    ):
        if low in fan and high in fan:
            style = {"color": LIGHT["main"], "alpha": alpha, "linewidth": 0}
            axes.fill_between(years, fan[low], fan[high], label=name, **style)
    axes.plot(years, fan["p50"], color=LIGHT["main"], linewidth=2.0, label="Median")
    style = {"color": LIGHT["withdraw"], "linewidth": 1.4, "linestyle": (0, (4, 2))}
    axes.plot(years, fan["mean"], label="Mean", **style)
    if level is not None:
        axes.axhline(level, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (1, 1.5)))
    if dates:
        date_axis(axes, years[0], years[-1], dates == "hour")
    else:
        axes.set_xlim(years[0], years[-1])
        axes.set_xlabel(across)
        number_axis(axes.xaxis, 10)
    number_axis(axes.yaxis)
    unit_above(axes, unit)
    legend_above(axes)


def heat(
    axes: "Axes",
    table: np.ndarray,
    across: Sequence[str],
    down: Sequence[str],
    unit: str,
    text: Callable[[float], str] = lambda share: f"{100 * share:.0f}",
) -> None:
    """Numbers in a grid [rows, columns], with the first row at the bottom.

    Larger numbers are darker, and numbers below zero have another colour. `text`: formats the
    number of a cell, by default as a percentage; a cell without a number is empty.
    """
    from matplotlib.patches import Rectangle

    rows, columns = table.shape
    top = float(np.nanmax(np.abs(table), initial=1e-9))
    for i in range(rows):
        for j in range(columns):
            if not np.isfinite(table[i, j]):
                continue
            alpha = DARKEST * abs(table[i, j]) / top
            colour = LIGHT["main" if table[i, j] >= 0 else "withdraw"]
            cell = Rectangle((j, i), 1, 1, facecolor=colour, alpha=alpha, linewidth=0)
            axes.add_patch(cell)
            axes.text(j + 0.5, i + 0.5, text(table[i, j]), ha="center", va="center")
    axes.set_xlim(0, columns)
    axes.set_ylim(0, rows)
    axes.set_xticks(np.arange(columns) + 0.5, list(across))
    axes.set_yticks(np.arange(rows) + 0.5, list(down))
    axes.tick_params(length=0)
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    unit_above(axes, unit)


@dataclass(frozen=True)
class Bars:
    """One series of a grouped bar chart."""

    label: str
    values: np.ndarray
    colour: str


def grouped(axes: "Axes", labels: Sequence[str], series: Sequence[Bars], unit: str) -> None:
    """Bars side by side for every label, with the zero line drawn over them."""
    width = 0.8 / len(series)
    position = np.arange(len(labels))
    for i, item in enumerate(series):
        offset = (i - (len(series) - 1) / 2) * width
        axes.bar(
            position + offset, item.values, width=width, color=LIGHT[item.colour], label=item.label
        )
    axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
    axes.set_xticks(position, list(labels))
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.6, len(labels) - 0.4)
    number_axis(axes.yaxis)
    unit_above(axes, unit)
    legend_above(axes)


@dataclass(frozen=True)
class Swing:
    """One line of a tornado chart: the effects of an increase and a decrease of an input, with the
    half-width of a 95 % interval."""

    name: str
    value: float
    text: str
    half: float = 0.0


def tornado(axes: "Axes", swings: Sequence[Swing], unit: str) -> None:
    """Horizontal bars from zero, with the first on top; gains and losses have different colours."""
    from matplotlib.ticker import NullLocator

    reach = max((abs(item.value) + item.half for item in swings), default=1.0) or 1.0
    for row, swing in enumerate(swings):
        colour = LIGHT["inject"] if swing.value >= 0 else LIGHT["withdraw"]
        axes.barh(row, swing.value, height=0.62, color=colour)
        if swing.half:
            line = {"ecolor": LIGHT["ink"], "elinewidth": 1.1, "capsize": 3.0}
            axes.errorbar(swing.value, row, xerr=swing.half, fmt="none", **line)
        side = 1 if swing.value >= 0 else -1
        end = swing.value + side * (swing.half + GAP * reach)
        axes.text(end, row, swing.text, va="center", ha="left" if side > 0 else "right")
    axes.set_yticks(range(len(swings)), [entry.name for entry in swings])
    axes.tick_params(axis="y", length=0, labelcolor=LIGHT["ink"])
    axes.set_ylim(len(swings) - 0.45, -0.55)
    axes.set_xlim(*_room(swings, reach))
    axes.xaxis.set_major_locator(NullLocator())
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    axes.axvline(0.0, color=LIGHT["other"], linewidth=0.8)
    unit_above(axes, unit)


def _room(swings: Sequence[Swing], reach: float) -> tuple[float, float]:
    """The limits of the horizontal axis, which leave room for the numbers at the ends of the
    bars."""
    names = max((len(item.name) for item in swings), default=0)
    points = max(200.0, WIDTH - LETTER * names - 24.0)  # of the plot, next to the names
    low, high = -0.04 * reach, 0.04 * reach
    for _ in range(40):  # a wider axis has wider texts: their share of it is below a half
        each_point = (high - low) / points
        for swing in swings:
            end = (
                abs(swing.value) + swing.half + GAP * reach + each_point * LETTER * len(swing.text)
            )
            low, high = (low, max(high, end)) if swing.value >= 0 else (min(low, -end), high)
            # The whisker also reaches to the other side of zero.
            back = swing.half - abs(swing.value)
            low, high = (min(low, -back), high) if swing.value >= 0 else (low, max(high, back))
    return low, high


@dataclass(frozen=True)
class Layer:
    """One layer of a stack over time."""

    label: str
    values: np.ndarray
    colour: str
    alpha: float = 1.0


def stack(axes: "Axes", years: np.ndarray, layers: Sequence[Layer], unit: str) -> None:
    """Layers on top of one another, each constant within its year; negative layers are below
    zero."""
    edges = np.append(years, years[-1] + (years[1] - years[0] if len(years) > 1 else 1.0))
    above, below = np.zeros(len(years)), np.zeros(len(years))
    for layer in layers:
        style = {"color": LIGHT[layer.colour], "alpha": layer.alpha, "linewidth": 0}
        over, under = above + np.maximum(layer.values, 0.0), below + np.minimum(layer.values, 0.0)
        # One part where the layer is on one side of zero all the time.
        parts = [(above, over)] if np.any(over > above) or not np.any(under < below) else []
        parts += [(below, under)] if np.any(under < below) else []
        for i, (first, last) in enumerate(parts):
            axes.fill_between(
                edges,
                np.append(first, first[-1]),
                np.append(last, last[-1]),
                step="post",
                label=layer.label if i == 0 else None,
                **style,
            )
        above, below = over, under
    if np.any(below < 0):
        axes.axhline(0.0, color=LIGHT["ink"], linewidth=0.8)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel("Year")
    number_axis(axes.xaxis, 10)
    number_axis(axes.yaxis)
    unit_above(axes, unit)
    legend_above(axes)


def scatter(axes: "Axes", points: Sequence[tuple[str, float, float, bool]], units) -> None:
    """Named points (name, x, y, strong) with their names next to them."""
    for _, x, y, strong in points:
        colour = LIGHT["main"] if strong else LIGHT["other"]
        axes.plot(x, y, "o", color=colour, markersize=9 if strong else 7)
    axes.margins(x=0.25, y=0.3)
    number_axis(axes.xaxis)
    number_axis(axes.yaxis)
    axes.set_xlabel(units[0])
    unit_above(axes, units[1])
    figure = axes.get_figure(root=True)
    layout = None if figure is None else figure.get_layout_engine()
    if figure is not None and layout is not None:
        layout.execute(figure)  # the names need to know how large the plot is
    for (name, x, y, strong), (left, up) in zip(points, _beside(axes, points), strict=True):
        # A name that had to leave its point has a line to it.
        line = {"arrowstyle": "-", "color": LIGHT["other"], "linewidth": 0.6}
        axes.annotate(
            name, (x, y), (left, up), textcoords="offset points", va="center",
            fontweight="bold" if strong else "normal", arrowprops=line if abs(up) > LINE else None,
        )  # fmt: skip


def _beside(axes: "Axes", points) -> list[tuple[float, float]]:
    """The offsets of the names, in typographic points. Names are placed from top to bottom, each at
    the nearest position that is free of names and of the chart's points.
    """
    width, height = axes.get_window_extent().size
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    at = [(width * (x - left) / (right - left), height * (y - low) / (high - low))
          for _, x, y, _ in points]  # fmt: skip
    taken = [(x - 5, x + 5, y) for x, y in at]
    count = [(0.0, 0.0)] * len(at)
    for i in sorted(range(len(at)), key=lambda i: -at[i][1]):
        (x, y), long = at[i], LETTER * len(points[i][0])
        digits = [(9.0, LINE * k * side) for k in range(12) for side in (1, -1)]
        free = (
            item for item in digits
            if 0 < y + item[1] < height and not any(
                x + item[0] < b and a < x + item[0] + long and abs(y + item[1] - level) < LINE
                for k, (a, b, level) in enumerate(taken) if k != i
            )
        )  # fmt: skip
        position = next(free, digits[0])
        taken.append((x + position[0], x + position[0] + long, y + position[1]))
        count[i] = position
    return count
