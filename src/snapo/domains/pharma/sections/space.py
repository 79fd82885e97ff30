"""Design space, proven ranges, capability, and where the spread comes from."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Mark, Missing, Section, Table, Text
from snapo.report.quantity import SPACE, finite, number, percent, quantity, with_unit

from ..quality.interval import draws_for
from . import pictures
from .model import place
from .run import Run
from .together import boundary


def design_space(run: Run) -> Section:
    """The probability that all limits hold over the axes, and the attribute that breaks them."""
    title, short = "Design space", "Design space"
    found, probability = run.get("design_space"), run.table("design_space.probability")
    if found is None or probability is None:
        text = f"No design space was mapped: {run.why_not('design space', 'design_space')}."
        return Section("space", title, short, [Missing(text)])
    binding = np.asarray(found["binding"])
    error = np.asarray(found["error"], float)
    blocks: list[Block] = [_words(found, probability, error)]
    for at, words in _slices(found, probability):
        low = np.asarray(found["low"], float)[at]
        high = np.asarray(found["high"], float)[at]
        blocks.append(_map(run, found, probability[at], binding[at], words, (low, high)))
    blocks += boundary(run, found)
    return Section("space", title, short, blocks)


def _slices(found: dict[str, Any], probability: np.ndarray) -> list[tuple[Any, str]]:
    """A third axis is shown at its ends and in the middle."""
    if probability.ndim == 2:
        return [(slice(None), "")]
    grid = found["grid"][2]
    chosen = sorted({0, len(grid) // 2, len(grid) - 1})
    name, unit = found["axes"][2], found["units"][2]
    return [((slice(None), slice(None), k), f"{name} {quantity(grid[k], unit)}") for k in chosen]


def _words(found: dict[str, Any], probability: np.ndarray, error: np.ndarray) -> Text:
    required, share = found["required"], float((probability >= found["required"]).mean())
    text = (
        f"At {percent(share, 0)} of the points of the map all limits hold with a probability of "
        f"{number(required)} or more; {number(found['samples'], 0)} batches per point, the same "
        f"draws at every point, standard error at most {percent(error.max())}. At "
        f"{percent(_surely(found), 0)} of the points this is so even at the lower end of the 95 % "
        "interval, within the dotted line of the map."
    )
    few = [level for level in found["levels"] if found["samples"] < draws_for(level)]
    if few:
        needed = " and ".join(f"{number(draws_for(level), 0)} for {level:g}" for level in few)
        text += (
            f" So few draws cannot make every contour sure: it takes {needed} at a point, all of "
            "them good."
        )
    if found.get("box") is None:
        return Text(text + " No box around the set point keeps the required probability.")
    box = found["box"]
    sides = [
        f"{name} {place(low)} to {place(high, unit)}"
        for name, unit, low, high in zip(found["axes"], found["units"], box["low"], box["high"])
    ]
    return Text(f"{text} The largest box inside: {', '.join(sides)}.")


def _surely(found: dict[str, Any]) -> float:
    return float((np.asarray(found["low"], float) >= found["required"]).mean())


def _map(
    run: Run,
    found,
    probability: np.ndarray,
    binding: np.ndarray,
    words: str,
    band: tuple[np.ndarray, np.ndarray],
) -> Chart:
    names, _ = run.names
    axes_names = found["axes"][:2]

    def paint(upper, lower):
        pictures.space(upper, found, probability, axes_names, band)
        upper.set_xlabel("")  # the axis below has the same name, and its numbers
        pictures.binding(lower, found, binding, axes_names, names)

    key = words.replace(" ", "").replace(".", "-").replace("\N{NO-BREAK SPACE}", "")
    svg = draw(f"space{key}", "Probability that all limits hold, with contours; below, the "
               "attribute that most often breaks its limits.", paint, 560, (1.2, 1.0))  # fmt: skip
    at = f" at {words}" if words else ""
    caption = (
        f"Above: probability that a batch keeps all limits{at}, deeper is better, with its "
        "contours; the boundary of the required probability lies between the dotted lines at 95 %: "
        "it is sure within the inner one, and possible up to the outer one. Below: the "
        "attribute that most often breaks its limits."
    )
    return Chart(svg, caption)


def ranges(run: Run) -> Section:
    """Proven acceptable ranges one at a time, and whether normal operation stays inside."""
    title, short = "Proven acceptable ranges and edge of failure", "Ranges"
    rows = run.get("ranges")
    if not rows:
        return Section("ranges", title, short, [Missing(_no_ranges(run))])
    normal = {each["name"]: each["normal"] for each in run.parameters}
    body = []
    for each in rows:
        inside = bool(each["probable"]["holds_normal"])
        sure = bool(each["probable"].get("sure_normal"))
        body.append(
            (
                with_unit(each["parameter"], each["unit"]),
                _edges(each["nominal"]),
                _edges(each["probable"]),
                Mark(inside and sure, _verdict(inside, sure)),
                " – ".join(place(x) for x in normal.get(each["parameter"], [])),
                _span(each["nominal"]),
                _span(each["probable"]),
                _ends(each["probable"].get("sure")),
                _ends(each["probable"].get("possible")),
            )
        )
    required = percent(rows[0]["required"], 0)
    head = [("Parameter", ""), ("Edge, nominal model", ""), (f"Edge, at {required}", ""),
            ("Normal range", ""), ("Normal range", ""), ("Nominal model", ""),
            (f"Probability {required}", ""), (f"sure at 95{SPACE}%", ""),
            (f"possible at 95{SPACE}%", "")]  # fmt: skip
    caption = (
        "How far one parameter may move with all others at their set point: by the model at its "
        "nominal numbers, and with the required probability under all variation "
        f"({number(rows[0]['samples'], 0)} batches per point). An edge names the attribute that "
        "fails beyond it; “studied range” where none does. Sure and possible: as far as the 95 % "
        "interval of the probability lies above, or reaches, what is required."
    )
    return Section("ranges", title, short, [Table(head, body, caption, 4)])


def _no_ranges(run: Run) -> str:
    return f"Proven ranges: none, since {run.why_not('proven ranges', 'design_space')}."


def _verdict(inside: bool, sure: bool) -> str:
    if inside:
        return "inside" if sure else "inside, not surely"
    return "not inside"


def _ends(ends: Sequence[float] | None) -> str:
    return "–" if ends is None else " – ".join(place(x) for x in ends)


def _span(found: dict[str, Any]) -> str:
    if found["low"] is None:
        return "set point fails"
    return f"{place(found['low'])} – {place(found['high'])}"


def _edges(found: dict[str, Any]) -> str:
    if found["low"] is None:
        return str(found["low_edge"]) or "set point fails"
    low, high = (found[key] or "studied range" for key in ("low_edge", "high_edge"))
    return low if low == high else f"{low} | {high}"


def capability(run: Run) -> Section:
    """Spread, Cpk and out-of-specification rates, and which source causes how much of them."""
    title, short = "Capability and sources of variation", "Capability"
    found = run.get("capability")
    if not found:
        text = f"Capability was not computed: {run.why_not('capability')}."
        return Section("capability", title, short, [Missing(text)])
    names, _ = run.names
    linear = run.get("spread.total") or [None] * len(names)
    rows = [
        (
            with_unit(name, run.attributes[q]["unit"]),
            number(found["mean"][q]),
            number(found["deviation"][q]),
            number(linear[q]),
            _cpk(found["cpk_batches"][q]),
            _cpk(found["cpk_low"][q], found["cpk_high"][q]),
            _cpk(found["cpk"][q]),
            number(found["sigmas"][q], 2),
            percent(found["outside"][q], 2),
            percent(found["error"][q], 2),
            " – ".join(number(x) for x in (found["quantiles"][q][0], found["quantiles"][q][2])),
        )
        for q, name in enumerate(names)
    ]
    head = [("Attribute", ""), ("Mean", ""), ("Deviation", ""), ("to first order", ""),
            ("Cpk, batch to batch", ""), ("over uncertain numbers", ""), ("Cpk, all together", ""),
            ("Sigmas to the edge", ""), ("Out of limits", ""), ("±", ""),
            ("1–99 %", "")]  # fmt: skip
    caption = (
        f"Over {number(found['batches'], 0)} simulated batches at the set point; together "
        f"{percent(found['joint'])} ± {percent(found['joint_error'])} break a limit. Cpk from "
        "batch to batch varies only what differs between batches, with the model's numbers at "
        "their nominal values; beside it, 5 to 95 % of it as these numbers are uncertain; all "
        "together counts both as variation. Cpk takes an attribute for normal; the share out of "
        "limits is counted. Where the deviation to first order is another than the counted one, "
        "the process is not linear over its variation."
    )
    blocks: list[Block] = [Table(head, rows, caption)]
    if (finite(found.get("failed")) or 0) > 0:
        blocks.append(Text(f"{number(found['failed'], 0)} batches gave no finite result."))
    blocks.append(_sources(run))
    return Section("capability", title, short, blocks)


def _cpk(*ends: float | None) -> str:
    """Two decimals, which tell a capable process; none where it, or its interval, is far beyond."""
    places = 2 if all(abs(finite(each) or 0.0) < 100 for each in ends) else 0
    return " – ".join(number(each, places) for each in ends)


def _sources(run: Run) -> Table | Missing:
    parts, total = run.table("spread.part"), run.table("spread.total")
    if parts is None or total is None:
        return Missing("Sources of variation were not computed.")
    names, _ = run.names
    share = np.divide(parts**2, (parts**2).sum(1, keepdims=True), out=np.zeros_like(parts),
                      where=parts.any(1, keepdims=True))  # fmt: skip
    rows = [
        (source, *(percent(x, 0) if x else "0" for x in share[:, v]))
        for v, source in enumerate(run.get("spread.sources", []))
    ]
    head = [("Source", ""), *((name, "") for name in names)]
    return Table(head, rows, "Share of each attribute's variance, to first order, source by source")
