"""Drawings of a report: SVG made by matplotlib that is small and reproducible, has light and dark
themes, and needs no network.

Colours are named by their meaning, for light and for dark backgrounds. Axes show dates by month or
day, and numbers with separators.
"""

import datetime
import io
import re
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from .quantity import MAXIMUM, MONTHS, TINY, decimals, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

LIGHT = {
    "ink": "#17212b",
    "muted": "#55616e",
    "rule": "#dde3e9",
    "paper": "#fefefe",
    "panel": "#f5f7f9",
    "main": "#1d3f72",
    "main-soft": "#c6d5ea",
    "inject": "#0072b2",
    "inject-soft": "#b8d9ec",
    "withdraw": "#d55e00",
    "withdraw-soft": "#f5cfb1",
    "other": "#7a8692",
    "reach": "#eaeef2",
    "limit": "#8d2f6b",
    "good": "#00704e",
    "bad": "#b3261e",
}
DARK = {
    "ink": "#e8edf2",
    "muted": "#a3afbb",
    "rule": "#323d49",
    "paper": "#12181f",
    "panel": "#1a222b",
    "main": "#8fb4ec",
    "main-soft": "#2b4163",
    "inject": "#56b4e9",
    "inject-soft": "#1f4459",
    "withdraw": "#f0883e",
    "withdraw-soft": "#5a3315",
    "other": "#8996a3",
    "reach": "#202a34",
    "limit": "#d889b9",
    "good": "#4cc49a",
    "bad": "#ff8a80",
}


DARKEST = 0.52  # of the main colour in a cell: ink on it has a contrast of 4.5 in both themes


def variables(colours: dict[str, str]) -> str:
    """CSS custom properties, `--ink: #17212b; …`."""
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


def by_variable(svg: str) -> str:
    """The same drawing, in which every colour of the light theme is replaced by `var(--name)`."""
    for name, colour in LIGHT.items():
        svg = svg.replace(colour, f"var(--{name})")
    return svg


def days(values: Sequence[str]) -> np.ndarray:
    """ISO dates [T] as numbers of a date axis [T]."""
    from matplotlib import dates as mdates

    return np.array([mdates.date2num(datetime.date.fromisoformat(day)) for day in values])


def local_times_of(labels: Sequence[str], steps_a_day: int) -> list[tuple[int, str]]:
    """(number, local time in ISO 8601) of the steps whose time cannot be computed from the step
    before: the first step, and the steps after a change of the clocks."""
    times = np.array(labels, "datetime64[h]").astype(np.int64)
    changes = np.flatnonzero(np.diff(times) != 24 // steps_a_day) + 1
    return [(n, labels[n]) for n in [0, *changes.tolist()]]


def times_of(
    local_times: Sequence[tuple[int, str]], steps_a_day: int, count: int
) -> list[datetime.datetime]:
    """The local times of `count` steps; `local_times`: see `local_times_of`."""
    step, times = datetime.timedelta(days=1) / steps_a_day, list[datetime.datetime]()
    for (first, text), (after, _) in zip(local_times, [*local_times[1:], (count, "")]):
        start = datetime.datetime.fromisoformat(text)
        times += [start + n * step for n in range(min(after, count) - first)]
    return times


def date_numbers(times: Sequence[datetime.datetime]) -> np.ndarray:
    """Times [T] as numbers of a date axis [T]."""
    from matplotlib import dates as mdates

    return np.array(mdates.date2num(times))


def date_axis(axes: "Axes", first: float, last: float, hours: bool = False) -> None:
    """Ticks at the starts of months, with the year below the first tick and below each January. A
    short axis has ticks at days; with `hours`, an axis of two or three days also has ticks at
    hours."""
    from matplotlib import dates as mdates

    axes.set_xlim(first, max(last, first + 1))
    span = last - first
    if span > 75:
        step = next((step for step in (1, 2, 3, 6, 12) if span / 30.4 / step <= 14), 24)
        ticks = [
            month_start
            for month_start in _month_starts(first, last)
            if month_start.month % step == 1 % step
        ]
        texts = [_month_text(tick, i == 0) for i, tick in enumerate(ticks)]
    else:
        every = max(1, round(span / 12))
        if hours and span <= 3:
            every = 0.25 if span > 1 else 0.125
        start = np.ceil(first / every) * every
        ticks = [mdates.num2date(day) for day in np.arange(start, last + every / 2, every)]
        texts = [
            _day_text(x, i == 0) if x.hour == 0 or i == 0 else x.strftime("%H:%M")
            for i, x in enumerate(ticks)
        ]
    axes.set_xticks([float(mdates.date2num(entry)) for entry in ticks], texts)


def _month_starts(first: float, last: float) -> list[datetime.date]:
    from matplotlib import dates as mdates

    start, end = mdates.num2date(first).date(), mdates.num2date(last).date()
    count = (end.year - start.year) * 12 + end.month - start.month + 1
    months = [start.year * 12 + start.month - 1 + i for i in range(count)]
    starts = [datetime.date(month // 12, month % 12 + 1, 1) for month in months]
    return [item for item in starts if start <= item <= end]


def _month_text(item: datetime.date, first: bool) -> str:
    month = MONTHS.split()[item.month - 1][:3]
    return f"{month}\n{item.year}" if first or item.month == 1 else month


def _day_text(item: datetime.datetime, first: bool) -> str:
    month = MONTHS.split()[item.month - 1][:3]
    return f"{item.day}\n{month} {item.year}" if first else f"{item.day}\n{month}"


def number_axis(axis: "Axis", count: int = 6) -> None:
    """Round numbers with thousands separators and as many decimals as their spacing needs."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))

    def text(value: float, position: int | None) -> str:
        ticks = axis.get_majorticklocs()
        gap = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
        digits = decimals([gap], 1)
        if abs(gap * 10**digits - round(gap * 10**digits)) > 1e-6:
            digits += 1  # a spacing of 2.5 or 0.25
        if 0 < np.abs(ticks).max() < TINY:
            digits = max(digits, MAXIMUM + 1)  # all of them as powers of ten
        return number(value, digits)

    axis.set_major_formatter(FuncFormatter(text))


WIDTH = 720.0  # points; the page shows a chart 960 pixels wide, so 9 points are 12 pixels
SANS = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: searchable, selectable, in the reader's font
    "svg.hashsalt": "snapo",
    "text.parse_math": False,  # a dollar sign is a currency
    "font.family": ["DejaVu Sans"],  # ships with matplotlib: the same measures everywhere
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "text.color": LIGHT["ink"],
    "axes.labelcolor": LIGHT["muted"],
    "axes.titlecolor": LIGHT["muted"],
    "xtick.color": LIGHT["other"],
    "ytick.color": LIGHT["other"],
    "xtick.labelcolor": LIGHT["muted"],
    "ytick.labelcolor": LIGHT["muted"],
    "axes.edgecolor": LIGHT["other"],
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": LIGHT["rule"],
    "grid.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "axes.linewidth": 0.8,
    "xtick.major.size": 3.0,
    "ytick.major.size": 0.0,
    "legend.frameon": False,
    "legend.borderaxespad": 0.0,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.6,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.6,
    "axes.unicode_minus": True,
    "axes.prop_cycle": f"cycler('color', ['{LIGHT['ink']}'])",  # nothing outside the theme
}
NOTHING = {"Creator": None, "Date": None, "Format": None, "Type": None}


def draw(
    name: str,
    alt: str,
    paint: Callable[..., None],
    height: float = 250.0,
    rows: Sequence[float] = (1.0,),
) -> Markup:
    """A chart as SVG for a page; its colours are CSS variables, and its text has the font of the
    page.

    **Arguments:**

    - `name`: unique on the page.
    - `alt`: a description of the chart for readers who cannot see it.
    - `paint`: called with one `Axes` per row. - `height`: in points; the width is always 720
      points.
    - `rows`: relative heights of panels that share the horizontal axis.
    """
    svg = _svg(paint, (WIDTH, height), {"nrows": len(rows), "height_ratios": rows, "sharex": True})
    return Markup(by_variable(_inline(svg, name, alt)))


def draw_alone(
    title: str, paint: Callable[..., None], size: tuple[float, float], columns: Sequence[float]
) -> str:
    """A separate picture with a white background and one `Axes` per column; `size` in points."""
    svg = _svg(paint, size, {"ncols": len(columns), "width_ratios": columns}, LIGHT["paper"])
    svg = _inline(svg, "picture", title).replace("var(--sans)", SANS)
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)


def _svg(paint, size, grid, face: str = "none") -> str:
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure((size[0] / 72, size[1] / 72), dpi=72, layout="constrained", facecolor=face)
        FigureCanvasSVG(figure)
        axes = figure.subplots(**grid, squeeze=False).ravel()
        paint(*axes)
        layout = figure.get_layout_engine()
        assert layout is not None
        # `savefig` would draw all once more, for nothing but this.
        layout.execute(figure)
        figure.set_layout_engine("none")
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata=NOTHING, facecolor=face)
    return file.getvalue()


def _inline(svg: str, name: str, alt: str) -> str:
    """Only the drawing, without a prologue, styles for the whole page, or names that clash on a
    page."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = svg.replace("xlink:href", "href")
    box = re.search(r'viewBox="([^"]*)"', svg)
    assert box is not None
    head = f'<svg class="chart" viewBox="{box[1]}" role="img" aria-label="{escape(alt)}">'
    svg = head + svg[svg.index(">") + 1 :]
    used = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg))
    names = {first or second for first, second in used}
    svg = re.sub(r' id="([^"]+)"', lambda m: _id(m[1], names, name), svg)
    svg = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", svg)
    svg = re.sub(r"(font: [^;\"']*?)'DejaVu Sans'[^;\"]*", r"\1var(--sans)", svg)
    return re.sub(r"\n\s*", "\n", svg).strip()


def _id(result: str, used: set[str], name: str) -> str:
    return f' id="{name}-{result}"' if result in used else ""


def legend_above(axes: "Axes", order: Sequence[str] = ()) -> None:
    """Draws the legend in one line above the plot, at the right, where it covers no data.

    `order` names the entries that come first.
    """
    handles, labels = axes.get_legend_handles_labels()
    rank = {label: i for i, label in enumerate(order)}
    selected = sorted(range(len(labels)), key=lambda i: rank.get(labels[i], len(rank)))
    axes.legend(
        [handles[i] for i in selected],
        [labels[i] for i in selected],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.02),
        ncols=6,
    )


def unit_above(axes: "Axes", unit: str) -> None:
    """Writes the unit of the vertical axis horizontally at the top left."""
    axes.set_title(unit, loc="left", pad=7)
