"""The plane of two states: the decision at every place, and paths through it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from snapo.problem.angle import wrap_angle
from snapo.report.axes import number_axis
from snapo.report.drawing import draw, unit_above
from snapo.report.folder import Folder
from snapo.report.page import Block, Chart, Section, Text
from snapo.report.sections.distribution import words
from snapo.report.sections.lacking import lacking
from snapo.report.theme import LIGHT

TITLE, SHORT = "Decisions and paths in the plane of states", "Plane"
LEVELS = 9  # of colour, from the lowest decision to the highest


def plane(run: Folder) -> Section:
    """A phase portrait; behind it the map of the policy where these are all the states."""
    found = run.get("plane")
    if not found:
        return Section("plane", TITLE, SHORT, [lacking(run, "plane of states")])
    if not found.get("states"):
        return Section("plane", TITLE, SHORT, [Text("The plant has one state alone.")])
    across, up = (_label(found, i) for i in (0, 1))
    alt = f"{across} and {up}: {len(found['paths'])} paths from their first states, as dots."
    svg = draw("plane", alt, lambda axes: _paint(axes, found), 330)
    caption = f"{len(found['paths'])} paths; a dot is a first state, a ring the last."
    if found.get("action"):
        caption += (
            " Behind them the decision of the first step: blue is the lowest, orange the highest, "
            "paper the middle."
        )
    blocks: list[Block] = [Chart(svg, caption)]
    if any(found["turn"]):
        blocks.append(Text("Angles are drawn between −π and π.", caveat=True))
    return Section("plane", TITLE, SHORT, blocks)


def _label(found: dict[str, Any], i: int) -> str:
    name, unit = words(found["states"][i]), found["units"][i]
    return f"{name}, {unit}" if unit not in ("", "1") else name


def _paint(axes: Axes, found: dict[str, Any]) -> None:
    if found.get("action"):
        _map(axes, found)
    for path in found["paths"]:
        x, y = (_drawn(path[i], found["turn"][i]) for i in (0, 1))
        axes.plot(x, y, color=LIGHT["ink"], linewidth=0.9)
        axes.plot(x[:1], y[:1], "o", color=LIGHT["ink"], markersize=4)
        axes.plot(x[-1:], y[-1:], "o", color=LIGHT["ink"], markersize=7, fillstyle="none")
    axes.set_xlim(found["across"][0], found["across"][-1])
    axes.set_ylim(found["up"][0], found["up"][-1])
    axes.set_xlabel(_label(found, 0))
    axes.grid(False)
    number_axis(axes.xaxis, 8)
    number_axis(axes.yaxis)
    unit_above(axes, _label(found, 1))


def _map(axes: Axes, found: dict[str, Any]) -> None:
    action = np.asarray(found["action"], float)
    low, high = float(action.min()), float(action.max())
    if not high > low:
        return
    edges = np.linspace(low, high, LEVELS + 1)
    sides = [2 * (i + 0.5) / LEVELS - 1 for i in range(LEVELS)]
    colours = [to_rgba(LIGHT["withdraw" if s > 0 else "inject"], 0.75 * abs(s)) for s in sides]
    axes.contourf(found["across"], found["up"], action, levels=edges, colors=colours)


def _drawn(values: Any, turn: bool) -> np.ndarray:
    """Numbers of a path; an angle between -pi and pi, with a gap where it jumps over the edge."""
    x = np.asarray(values, float)
    if not turn:
        return x
    folded = np.array(wrap_angle(x))
    folded[1:][np.abs(np.diff(folded)) > np.pi] = np.nan
    return folded
