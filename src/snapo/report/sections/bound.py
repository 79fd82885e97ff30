"""The value between two bounds: what the trained policy may still leave on the table."""

from ..axes import number_axis
from ..drawing import draw
from ..folder import Folder
from ..page import Block, Chart, Section, Table, Text
from ..quantity import decimals, finite, number, percent
from ..theme import LIGHT
from .lacking import lacking

NAMES = {"lower": "Trained policy", "upper": "Upper bound", "gap": "Gap, path by path"}


def bound(run: Folder) -> Section:
    """Lower and upper bound with their 95 % intervals, and the gap between them in a sentence."""
    title, short = "Bounds: how much better could a policy be?", "Bounds"
    if not run.get("bound"):
        return Section("bound", title, short, [_without(run)])
    found = {name: run.get(f"bound.{name}") for name in NAMES}
    places = decimals([finite(found["upper"]["value"])], 6)
    blocks: list[Block] = [Text(_sentence(run, found, places)), _chart(run, found, places)]
    blocks.append(_table(run, found, places))
    low, high = (finite(each) for each in run.get("bound.sure") or (None, None))
    if low is not None and high is not None:
        worth = f"from {number(low, decimals([low], 4))} to {number(high, decimals([high], 4))}"
        blocks.append(Text(f"As sure outcomes of the same utility, the two values are {worth}."))
    return Section("bound", title, short, blocks)


def _without(run: Folder) -> Block:
    if "bound" in run.parts:
        return lacking(run, "bound")
    return Text(
        "The value of this run was not bounded from above: `snapo certify` does, or says why not."
    )


def _sentence(run: Folder, found: dict, places: int) -> str:
    """ "No policy whatever earns more than EUR 78,498 …"."""
    top, gap = finite(found["upper"]["high"]), finite(found["gap"]["high"])
    low = finite(found["lower"]["value"])
    if top is None or gap is None or low is None:
        return "There are too few paths for an interval."
    if little := run.get("bound.says_little"):
        return f"This bound {little}. No policy earns more than {run.worth(top, None, places)}."
    share = f", {percent(gap / abs(low), 2)} of its value," if low else ""
    return (
        f"No policy whatever earns more than {run.worth(top, None, places)}, and the trained one"
        f" leaves at most {run.worth(gap, None, places)}{share} on the table (95 % intervals)."
    )


def _chart(run: Folder, found: dict, places: int) -> Chart:
    rows = [(NAMES[name], found[name]) for name in ("lower", "upper")]
    exact = finite(run.get("dynamic_programming"))
    texts = "; ".join(
        f"{name}: {number(each['value'], places)}, {number(each['low'], places)} to"
        f" {number(each['high'], places)}"
        for name, each in rows
    )

    def paint(axes) -> None:
        for row, (_, each) in enumerate(rows):
            colour = LIGHT["main"] if row == 0 else LIGHT["withdraw"]
            reach = [[each["value"] - each["low"]], [each["high"] - each["value"]]]
            style = {"fmt": "o", "color": colour, "ecolor": colour, "capsize": 5.0}
            axes.errorbar([each["value"]], [row], xerr=reach, elinewidth=2.0, **style)
        if exact is not None:
            axes.axvline(exact, color=LIGHT["other"], linestyle="--")
            axes.text(exact, -0.5, " exact", color=LIGHT["muted"], va="center")
        axes.set_yticks(range(len(rows)), [name for name, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.7)
        axes.grid(axis="x")
        axes.margins(x=0.1)
        number_axis(axes.xaxis)
        axes.set_xlabel(run.unit)

    svg = draw("bounds", f"Two points with 95 % intervals. {texts}.", paint, 120)
    caption = (
        "The upper bound is the value and the gap: the mean over fresh paths of what the best"
        " decisions of each path earn when its future is known, less what the policy earns."
        " A penalty for knowing it costs nothing on average to those who do not"
        f" ({run.get('bound.words')})."
    )
    return Chart(svg, caption)


def _table(run: Folder, found: dict, places: int) -> Table:
    rows = [
        (NAMES[name], *(number(found[name][key], places) for key in ("value", "low", "high")))
        for name in NAMES
    ]
    head = [("", ""), ("Value", run.unit), ("95 % from", run.unit), ("to", run.unit)]
    caption = f"Bounds on {number(run.get('bound.paths'), 0)} paths"
    return Table(head, rows, caption)
