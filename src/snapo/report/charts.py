"""The charts of a report, drawn into existing axes, without knowledge of a domain."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from snapo.solver.statistics import critical

from .drawing import DARKEST, LIGHT, date_axis, legend_above, number_axis, unit_above
from .quantity import decimals, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Standard errors to either side for 95 %, of a value and of a sensitivity from 32 blocks.
INTERVAL = critical()


@dataclass(frozen=True)
class LadderBar:
    """One bar of a ladder chart: a text at the left, a number at the right, and an error bar."""

    name: str
    value: float
    text: str
    error: float | None = None
    strong: bool = False


@dataclass(frozen=True)
class Line:
    """A line over time; `style` "-", "--" or ":"; `step`: whether a value is constant within its
    day."""

    label: str
    values: np.ndarray
    colour: str
    style: str = "-"
    width: float = 1.6
    step: bool = False


def ladder(axes: "Axes", bars: Sequence[LadderBar]) -> None:
    """Horizontal bars from zero, with the first on top and the number next to each bar."""
    from matplotlib.ticker import NullLocator

    values = np.array([rung.value for rung in bars])
    reach = np.max(np.abs(values)) or 1.0
    for row, bar in enumerate(bars):
        colour = LIGHT["main"] if bar.strong else LIGHT["main-soft"]
        axes.barh(row, bar.value, height=0.62, color=colour)
        if bar.error:
            line = {"ecolor": LIGHT["withdraw"], "elinewidth": 1.6, "capsize": 4.0}
            axes.errorbar(bar.value, row, xerr=INTERVAL * bar.error, fmt="none", **line)
        end = max(bar.value + INTERVAL * (bar.error or 0.0), 0.0)
        weight = "bold" if bar.strong else "normal"
        axes.text(end + 0.012 * reach, row, bar.text, va="center", fontweight=weight)
    axes.set_yticks(range(len(bars)), [rung.name for rung in bars])
    axes.tick_params(axis="y", length=0, labelcolor=LIGHT["ink"])
    axes.set_ylim(len(bars) - 0.45, -0.55)
    longest = max(len(rung.text) for rung in bars)
    axes.set_xlim(min(values.min() * 1.08, 0.0), max(values.max(), 0.0) + reach * 0.014 * longest)
    axes.xaxis.set_major_locator(NullLocator())
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    axes.axvline(0.0, color=LIGHT["other"], linewidth=0.8)


def waterfall(axes: "Axes", before: LadderBar, steps: Sequence[LadderBar], now: LadderBar) -> None:
    """Horizontal bars from one total to another; each bar begins where the bar above it ends. The
    scale covers the totals and the steps between them, but not zero.
    """
    from matplotlib.ticker import NullLocator

    bars = [before, *steps, now]
    levels = before.value + np.cumsum([0.0, *(step.value for step in steps)])
    reach = float(np.ptp(levels)) or max(abs(before.value), 1.0) * 1e-3
    low, high = float(levels.min()) - 0.25 * reach, float(levels.max())
    starts = np.array([low, *levels[:-1], low])
    stops = np.array([before.value, *levels[1:], now.value])
    longest = max(len(bar.text) for bar in bars)
    for row, (bar, start, stop) in enumerate(zip(bars, starts, stops, strict=True)):
        colour = "main" if bar.strong else "withdraw" if stop >= start else "inject"
        axes.barh(row, stop - start, left=start, height=0.62, color=LIGHT[colour])
        right = max(start, stop)
        if bar.error and not bar.strong:
            half = INTERVAL * bar.error
            line = {"ecolor": LIGHT["ink"], "elinewidth": 1.2, "capsize": 3.0}
            axes.errorbar(stop, row, xerr=half, fmt="none", **line)
            right = max(right, stop + half)
        if 0 < row < len(bars) - 1:
            axes.plot([stop, stop], [row, row + 1], color=LIGHT["other"], linewidth=0.8, zorder=0)
        weight = "bold" if bar.strong else "normal"
        axes.text(right + 0.015 * reach, row, bar.text, va="center", fontweight=weight)
    axes.set_yticks(range(len(bars)), [bar.name for bar in bars])
    axes.tick_params(axis="y", length=0, labelcolor=LIGHT["ink"])
    axes.set_ylim(len(bars) - 0.45, -0.55)
    axes.set_xlim(low, high + reach * (0.1 + 0.022 * longest))
    axes.xaxis.set_major_locator(NullLocator())
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)


def lines(axes: "Axes", when: np.ndarray, curves: Sequence[Line], unit: str) -> None:
    """Lines over dates [T], with a gap if a value is not a number."""
    for curve in curves:
        style = "steps-post" if curve.step else "default"
        axes.plot(
            when,
            curve.values,
            color=LIGHT[curve.colour],
            linestyle=curve.style,
            linewidth=curve.width,
            drawstyle=style,
            label=curve.label,
        )
    date_axis(axes, when[0], when[-1])
    number_axis(axes.yaxis)
    unit_above(axes, unit)
    legend_above(axes)


def fan(axes: "Axes", when, mean, low, high, unit: str, *, reach=None, limits=None) -> None:
    """A mean with its 5-95 % band, the reachable range behind it, and the limits around it. All
    arrays are [T+1]; `low` and `high` may be None; `reach` and `limits` are pairs (low, high).
    """
    if reach is not None:
        axes.fill_between(when, *reach, color=LIGHT["reach"], linewidth=0, label="Reachable")
    if limits is not None:
        style = {"color": LIGHT["limit"], "linewidth": 1.1, "linestyle": (0, (4, 2))}
        axes.plot(when, limits[1], label="Limits", **style)
        axes.plot(when, limits[0], **style)
    if low is not None and high is not None:
        axes.fill_between(
            when, low, high, color=LIGHT["main-soft"], linewidth=0, label="5–95 % of paths"
        )
    axes.plot(when, mean, color=LIGHT["main"], linewidth=2.0, label="Mean")
    date_axis(axes, when[0], when[-1])
    number_axis(axes.yaxis)
    axes.margins(y=0.04)
    unit_above(axes, unit)
    legend_above(axes)


def signed_strip(axes: "Axes", when, values, unit: str, names, *, half=None, compare=None) -> None:
    """One thin bar for each day: `names` = (label above zero, label below); `compare`: a second
    plan. `half` [T]: the half-widths of 95 % intervals, drawn as whiskers; days without a value are
    NaN.
    """
    step = float(np.min(np.diff(when), initial=1.0))
    edges = np.append(when, when[-1] + step)
    # One outline for all days: bars side by side would show hairlines between them.
    for sign, colour, name in ((1, "withdraw", names[0]), (-1, "inject", names[1])):
        part = sign * np.maximum(sign * values, 0.0)
        axes.stairs(part, edges, fill=True, color=LIGHT[colour], linewidth=0, label=name)
    if half is not None:
        style = {"color": LIGHT["ink"], "linewidth": 0.5, "label": "95 % interval"}
        axes.vlines(when + step / 2, values - half, values + half, **style)
    if compare is not None:
        style = {"color": LIGHT["limit"], "linewidth": 1.3, "baseline": None}
        axes.stairs(compare[1], edges, label=compare[0], **style)
    axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
    date_axis(axes, when[0], when[-1] + step)
    number_axis(axes.yaxis)
    unit_above(axes, unit)
    legend_above(axes)


def signed_bars(axes: "Axes", labels, values, unit: str, *, names, half, compare) -> None:
    """A bar for each label, with a colour and a name for each sign, whiskers for 95 % intervals,
    and a comparison.

    **Arguments:**

    - `half`: [n] half-widths of 95 % intervals, or None. - `compare`: (name, [n]) drawn as bold
      ticks across the bars, or None.
    """
    position = np.arange(len(values))
    above = np.where(values > 0, values, np.nan)
    below = np.where(values <= 0, values, np.nan)
    for part, colour, name in ((above, "withdraw", names[0]), (below, "inject", names[1])):
        if np.isfinite(part).any():
            axes.bar(position, part, width=0.6, color=LIGHT[colour], label=name)
    if half is not None:
        caps = 4.0 if len(values) <= 24 else 1.5
        line = {"ecolor": LIGHT["ink"], "elinewidth": 1.3, "capsize": caps}
        axes.errorbar(position, values, yerr=half, fmt="none", label="95 % interval", **line)
    if compare is not None:
        style = {"color": LIGHT["limit"], "linewidth": 2.4}
        left, right = position - 0.4, position + 0.4
        axes.hlines(compare[1], left, right, label=compare[0], **style)
    axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
    axes.set_xticks(position, labels)
    axes.tick_params(axis="x", length=0)
    adjacent = max(0.0, (6 - len(values)) / 2)  # a single bar would fill the page
    axes.set_xlim(-0.6 - adjacent, len(values) - 0.4 + adjacent)
    axes.margins(y=0.06)
    number_axis(axes.yaxis, 8)
    unit_above(axes, unit)
    legend_above(axes, order=[*names, "95 % interval"])


def histogram(axes: "Axes", edges, counts, marks, unit: str) -> None:
    """Shares of paths in bins; `marks` [(text, position)] are drawn as lines, the first in bold.

    A mark whose text would overlap an earlier one is omitted; texts stay within the axes.
    """
    share = counts / max(counts.sum(), 1.0) * 100
    axes.stairs(share, edges, fill=True, color=LIGHT["main-soft"])
    axes.stairs(share, edges, color=LIGHT["main"], linewidth=0.9)
    top = share.max() * 1.02
    width = edges[-1] - edges[0]
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, top * 1.16)
    drawn: list[tuple[float, float]] = []  # the areas that texts cover
    for text, position in marks:
        half = (len(text) + 1) * 0.0047 * width  # at 9 points on a chart of 720
        if not edges[0] <= position <= edges[-1]:
            continue
        middle = min(max(position, edges[0] + half), edges[-1] - half)
        span = (middle - half, middle + half)
        if any(span[0] < right and left < span[1] for left, right in drawn):
            continue
        style = (1.6, "ink", "-") if text == marks[0][0] else (0.9, "muted", (0, (3, 2)))
        drawn.append(span)
        line = dict(zip(("linewidth", "color", "linestyle"), style, strict=True))
        axes.vlines(position, 0.0, top * 1.03, **{**line, "color": LIGHT[style[1]]})
        axes.text(middle, top * 1.05, text, ha="center", va="bottom")
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 5)
    unit_above(axes, "% of paths")
    axes.set_xlabel(unit)


def trace(axes: "Axes", steps, curves: Sequence[Line], unit: str, log: bool = False) -> None:
    """Lines over training steps; the axis does not cover the large changes at the start of
    training."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    for curve in curves:
        available = np.isfinite(curve.values)
        # Few points are single measurements: they get a dot each.
        dots = "o" if available.sum() <= 40 and not curve.step else None
        drawn = "steps-post" if curve.step else "default"
        style = {"linestyle": curve.style, "linewidth": curve.width, "drawstyle": drawn}
        axes.plot(
            steps[available],
            curve.values[available],
            color=LIGHT[curve.colour],
            marker=dots,
            markersize=3.2,
            label=curve.label,
            **style,
        )
    if log:
        axes.set_yscale("log")
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
    else:
        every = np.concatenate([curve.values[np.isfinite(curve.values)] for curve in curves])
        low, high = np.quantile(every, [0.04, 1.0])
        room = max(high - low, 1e-9 * abs(high), 1e-12)
        axes.set_ylim(low - 0.06 * room, high + 0.08 * room)
        number_axis(axes.yaxis, 5)
    axes.set_xlim(steps[0], max(steps[-1], steps[0] + 1))
    number_axis(axes.xaxis, 8)
    unit_above(axes, unit)
    legend_above(axes)


def regions(axes: "Axes", level, below, above, here, names, units: tuple[str, str]) -> None:
    """Regions of prices over a level: one action at prices below `below`, another above `above`,
    and none between them.

    `here` is (level, price) today; `names` (under, between, over) are written into the regions.
    """
    prices = np.concatenate([below, above, [here[1]]])
    prices = prices[np.isfinite(prices)]
    room = max(np.ptp(prices), 0.02 * np.max(np.abs(prices)), 1e-9)
    low, high = prices.min() - 0.3 * room, prices.max() + 0.3 * room
    axes.fill_between(level, low, below, color=LIGHT["inject-soft"], linewidth=0)
    axes.fill_between(level, above, high, color=LIGHT["withdraw-soft"], linewidth=0)
    axes.plot(level, below, color=LIGHT["inject"], linewidth=1.8, label=f"{names[0]} below")
    axes.plot(level, above, color=LIGHT["withdraw"], linewidth=1.8, label=f"{names[2]} above")
    axes.axhline(here[1], color=LIGHT["ink"], linewidth=1.0, linestyle=(0, (4, 2)), label="Spot")
    axes.plot(*here, "o", color=LIGHT["ink"], markersize=7, label="Today")
    middle = (level[0] + level[-1]) / 2
    axes.text(middle, low + 0.05 * room, names[0], ha="center", color=LIGHT["ink"])
    axes.text(middle, high - 0.05 * room, names[2], ha="center", va="top", color=LIGHT["ink"])
    between = np.nanmedian((below + above) / 2)
    if np.nanmedian(above - below) > 0.12 * (high - low):
        axes.text(middle, between, names[1], ha="center", va="center", color=LIGHT["ink"])
    axes.set_xlim(level[0], level[-1])
    axes.set_ylim(low, high)
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis)
    axes.set_xlabel(units[0])
    unit_above(axes, units[1])
    legend_above(axes)


def swept_line(axes: "Axes", points: Sequence[tuple], name: str, unit: str) -> None:
    """A value as a function of a number, with its 95 % band; `points`: (number, (value, standard
    error))."""
    x = np.array([at for at, _ in points])
    y = np.array([value for _, (value, _) in points])
    half = INTERVAL * np.array([error or 0.0 for _, (_, error) in points])
    axes.fill_between(x, y - half, y + half, color=LIGHT["main-soft"], linewidth=0)
    axes.plot(x, y, color=LIGHT["main"], marker="o", markersize=3.2, linewidth=1.8)
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis)
    axes.set_xlabel(name)
    unit_above(axes, unit)


def swept_map(
    axes: "Axes",
    marks: Sequence[Sequence[str]],
    cells: Mapping[tuple[str, str], float | None],
    names: Sequence[str],
) -> None:
    """A value over two axes, with a cell for each pair of their `marks`; darker is higher."""
    from matplotlib.patches import Rectangle

    depth, few = _depth(cells.values()), len(marks[0]) <= 10
    digits = decimals(cells.values(), 4)
    for i, across in enumerate(marks[0]):
        for j, up in enumerate(marks[1]):
            value = cells.get((across, up))
            if value is None:
                continue
            face = {"facecolor": LIGHT["main"], "alpha": depth(value), "linewidth": 0}
            axes.add_patch(Rectangle((i, j), 1, 1, **face))
            if few:
                text = number(value, digits)
                axes.text(i + 0.5, j + 0.5, text, ha="center", va="center", color=LIGHT["ink"])
    step = -(-len(marks[0]) // 12)
    axes.set_xticks([i + 0.5 for i in range(0, len(marks[0]), step)], marks[0][::step])
    step = -(-len(marks[1]) // 20)
    axes.set_yticks([j + 0.5 for j in range(0, len(marks[1]), step)], marks[1][::step])
    axes.set_xlim(0, len(marks[0]))
    axes.set_ylim(0, len(marks[1]))
    axes.grid(False)
    axes.set_xlabel(names[0])
    unit_above(axes, names[1])


def swept_points(
    axes: "Axes", points: Sequence[tuple[float, float, float]], names: Sequence[str]
) -> None:
    """A value at points (across, up, value); darker is higher."""
    depth = _depth([value for _, _, value in points])
    for across, up, value in points:
        face = {"color": LIGHT["main"], "alpha": depth(value), "markersize": 11.0}
        axes.plot(across, up, "o", markeredgewidth=0, **face)
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis, 8)
    axes.set_xlabel(names[0])
    unit_above(axes, names[1])


def _depth(values: Iterable[float | None]) -> Callable[[float], float]:
    """The depth of a value's colour, from 0.08 for the smallest to `DARKEST` for the largest
    value."""
    finite = [value for value in values if value is not None]
    low, high = min(finite), max(finite)
    return lambda value: 0.08 + (DARKEST - 0.08) * (value - low) / ((high - low) or 1.0)
