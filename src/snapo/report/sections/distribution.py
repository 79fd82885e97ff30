"""How the total of every output is distributed over the paths."""

from typing import Any

from .. import charts
from ..drawing import draw
from ..folder import Folder
from ..page import Block, Chart, Section, Table
from ..quantity import array, decimals, finite, number, quantity, unit_words
from .lacking import lacking

PICTURES = 4  # of outputs; all stand in the table
COLUMNS = (
    ("Mean", "mean"), ("Std deviation", "standard_deviation"), ("Worst 5 %, mean", "tail_mean"),
    ("1 %", "quantiles.p01"), ("5 %", "quantiles.p05"), ("Median", "quantiles.p50"),
    ("95 %", "quantiles.p95"), ("99 %", "quantiles.p99"),
)  # fmt: skip


def distribution(run: Folder) -> Section:
    """A histogram for each of the first outputs, and one table for all of them."""
    title, short = "Distribution of the totals", "Distribution"
    found = [each for each in run.get("distribution", []) if each.get("paths")]
    if not found:
        return Section("distribution", title, short, [lacking(run, "distribution")])
    first = run.get("objective_output")
    found = sorted(found, key=lambda each: each["name"] != first)
    blocks: list[Block] = [
        _picture(f"distribution-{i}", each) for i, each in enumerate(found[:PICTURES])
    ]
    return Section("distribution", title, short, [*blocks, _table(found)])


def words(name: str) -> str:
    """A name of code as words: "cash_flow" as "Cash flow", "plant.mass" as "Plant mass"."""
    text = name.replace("_", " ").replace(".", " ")
    return text[:1].upper() + text[1:]


def _picture(anchor: str, each: dict[str, Any]) -> Chart:
    edges, counts = array(each.get("edges")), array(each.get("counts"))
    assert edges is not None and counts is not None
    quantiles = each.get("quantiles", {})
    marks = [("mean", each.get("mean")), ("5 %", quantiles.get("p05"))]
    marks.append(("95 %", quantiles.get("p95")))
    shown = [(text, position) for text, position in marks if finite(position) is not None]
    name, unit = words(each["name"]), unit_words(each.get("unit", ""))
    mean = quantity(each.get("mean"), unit)
    alt = f"Histogram of {name} over {number(each['paths'], 0)} paths; its mean is {mean}."
    label = f"{name}, {unit}" if unit else name
    svg = draw(anchor, alt, lambda axes: charts.histogram(axes, edges, counts, shown, label), 220)
    caption = (
        f"{name}: total of a path, {number(each['paths'], 0)} paths of the exact simulator. Paths "
        "beyond the edges are in the outermost bins."
    )
    return Chart(svg, caption)


def _table(found: list[dict[str, Any]]) -> Table:
    rows = []
    for each in found:
        numbers = [_entry(each, path) for _, path in COLUMNS]
        places = decimals(numbers, 5)
        rows.append(
            (
                words(each["name"]),
                unit_words(each.get("unit", "")),
                *(number(n, places) for n in numbers),
            )
        )
    head = [("Output", ""), ("Unit", ""), *((name, "") for name, _ in COLUMNS)]
    return Table(head, rows, "Totals of a path", 2)


def _entry(table: dict[str, Any], path: str) -> Any:
    found: Any = table
    for key in path.split("."):
        found = found.get(key) if isinstance(found, dict) else None
    return found
