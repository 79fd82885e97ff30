"""State, decisions and outputs over time as bands of quantiles."""

from typing import Any

import numpy as np

from ..bands import quantile_fan
from ..drawing import draw
from ..folder import Folder
from ..page import Block, Chart, Section, Text
from ..quantity import array, number, unit_words
from .distribution import words
from .lacking import lacking

MOST = 12  # pictures of one kind
HEADINGS = {"state": "state", "action": "decision", "outputs": "output of one step"}


def fans(run: Folder) -> Section:
    """A fan for every number of the state, of the decision and of the outputs."""
    title, short = "Over time", "Over time"
    series = run.get("profile.series", [])
    if not series:
        return Section("fans", title, short, [lacking(run, "profile")])
    blocks: list[Block] = []
    for kind in HEADINGS:
        of_kind = [each for each in series if each["kind"] == kind]
        blocks += [_fan(run, f"fan-{kind}-{i}", each) for i, each in enumerate(of_kind[:MOST])]
        if len(of_kind) > MOST:
            blocks.append(Text(f"{len(of_kind) - MOST} more of this kind are not drawn.", True))
    blocks += [Text(str(note), caveat=True) for note in run.get("profile.notes", [])]
    return Section("fans", title, short, blocks)


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
