"""State, decisions and outputs over time as bands of quantiles."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..bands import quantile_fan
from ..drawing import draw
from ..folder import Folder
from ..page import Block, Chart, Section, Text
from ..quantity import array, finite, number, quantity, unit_words
from .distribution import words
from .lacking import lacking

MOST = 12  # pictures of one kind
ENDS = ("mean", "p01", "p99")
HEADINGS = {"state": "state", "action": "decision", "outputs": "output of one step"}


def fans(run: Folder, factor: Callable[[dict[str, Any]], float] | None = None) -> Section:
    """A fan for every number of the state, of the decision and of the outputs.

    `factor`: by what the numbers of a series are multiplied, 1 for all where none is given.
    """
    title, short = "Over time", "Over time"
    series = run.get("profile.series", [])
    if not series:
        return Section("fans", title, short, [lacking(run, "profile")])
    if factor is not None:
        series = [_times(each, factor(each)) for each in series]
    blocks: list[Block] = []
    for kind in HEADINGS:
        of_kind = [each for each in series if each["kind"] == kind]
        same = {id(each): level for each in of_kind if (level := _constant(each)) is not None}
        drawn = [each for each in of_kind if id(each) not in same]
        blocks += [_fan(run, f"fan-{kind}-{i}", each) for i, each in enumerate(drawn[:MOST])]
        if len(drawn) > MOST:
            blocks.append(Text(f"{len(drawn) - MOST} more of this kind are not drawn.", True))
        blocks += [_same(run, each, same[id(each)]) for each in of_kind if id(each) in same]
    blocks += [Text(str(note), caveat=True) for note in run.get("profile.notes", [])]
    return Section("fans", title, short, blocks)


def _times(each: dict[str, Any], factor: float) -> dict[str, Any]:
    def product(x: Any) -> float | None:
        return None if (known := finite(x)) is None else factor * known

    return {k: [product(x) for x in v] if isinstance(v, list) else v for k, v in each.items()}


def _constant(each: dict[str, Any]) -> float | None:
    """The one number that a series is at every step of every path; None where it moves."""
    lines = [array(each[name]) for name in ENDS if isinstance(each.get(name), list)]
    if len(lines) < len(ENDS) or any(line is None for line in lines):
        return None
    found = np.concatenate([line for line in lines if line is not None])
    return float(found[0]) if np.allclose(found, found[0], rtol=1e-12, atol=0.0) else None


def _same(run: Folder, each: dict[str, Any], level: float) -> Text:
    """A sentence in place of a picture of one straight line."""
    kind, step = HEADINGS[each["kind"]], run.get("step", "step")
    size = quantity(level, str(each.get("unit") or ""))
    return Text(f"{words(each['name'])} ({kind}) is {size} at every {step}.", caveat=True)


def _fan(run: Folder, anchor: str, each: dict[str, Any]) -> Chart | Text:
    lines = {
        name: values
        for name, given in each.items()
        if isinstance(given, list) and (values := array(given)) is not None
    }
    name, step = words(each["name"]), str(run.get("step", "step"))
    if "mean" not in lines:
        return Text(f"{name} is finite on no path.", caveat=True)
    when = np.arange(len(lines["mean"]))
    paths = number(run.get("profile.paths"), 0)
    alt = f"{name} over {len(when)} {step}s: mean, median and bands of quantiles of {paths} paths."
    label = f"{name}, {unit_words(each['unit'])}" if each.get("unit") else name
    svg = draw(
        anchor, alt, lambda axes: quantile_fan(axes, when, lines, label, None, step.capitalize()),
        230,
    )  # fmt: skip
    return Chart(svg, f"{name} ({HEADINGS[each['kind']]}), {paths} paths of the exact simulator.")
