"""From matplotlib to SVG that may stand inside a page: small, reproducible, themed, offline."""

import io
import re
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from .theme import LIGHT, by_variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 720.0  # points; the page shows a chart 960 pixels wide, so 9 points are 12 pixels
SANS = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: searchable, selectable, in the reader's own font
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
    """A chart as SVG for a page, its colours CSS variables and its text in the page's font.

    **Arguments:**

    - `name`: unique on the page.
    - `alt`: the chart in words, for a reader who does not see it.
    - `paint`: called with one `Axes` per row.
    - `height`: points; the width is always 720.
    - `rows`: relative heights of panels that share the horizontal axis.
    """
    svg = _svg(paint, (WIDTH, height), {"nrows": len(rows), "height_ratios": rows, "sharex": True})
    return Markup(by_variable(_inline(svg, name, alt)))


def draw_alone(
    title: str, paint: Callable[..., None], size: tuple[float, float], columns: Sequence[float]
) -> str:
    """A picture that stands alone, on white: one `Axes` per column; `size` in points."""
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
    """Only the drawing: no prologue, no page-wide style, no names that clash on a page."""
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
    """The legend in one line above the plot, at its right, where no data can lie under it.

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
    """The unit of the vertical axis, level, at the top left."""
    axes.set_title(unit, loc="left", pad=7)
