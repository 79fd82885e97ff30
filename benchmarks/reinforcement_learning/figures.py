"""All curves of a file of runs: value against processor time and against simulated steps.

`python -m benchmarks.reinforcement_learning --out runs.csv --figure curves.svg`
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .clock import Point
from .table import runs
from .told import NAMES, Told

COLOURS = {"snapo": "#0072b2", "ppo": "#e69f00", "sac": "#d55e00", "td3": "#009e73",
           "regression": "#666666"}  # fmt: skip
PANELS = (("processor", "seconds of processor time"), ("steps", "simulated steps"))
FLOOR = 0.4  # below the least best value of a run, of the distance to the highest


def draw(points: Sequence[Point], told: Mapping[str, Told], file: Path) -> None:
    """Two panels for each problem, with a line for every method and seed; dashed: the best possible
    value."""
    problems = [name for name in told if any(point.problem == name for point in points)]
    # The same file from the same runs: no date in it, and no random names.
    with matplotlib.rc_context({"svg.hashsalt": "snapo", "font.size": 8, "svg.fonttype": "none"}):
        figure = Figure(figsize=(8.5, 2.1 * len(problems) + 0.5), layout="constrained")
        axes = figure.subplots(len(problems), len(PANELS), squeeze=False)
        for row, problem in zip(axes, problems):
            own = [point for point in points if point.problem == problem]
            for panel, (column, label) in zip(row, PANELS):
                _panel(panel, own, told[problem], column)
                panel.set_xlabel(label if problem == problems[-1] else "")
            row[0].set_ylabel(f"{problem}\nvalue")
        handles = {line.get_label(): line for panel in axes.flat for line in panel.get_lines()}
        shown = {name: handles[name] for name in NAMES.values() if name in handles}
        figure.legend(shown.values(), shown.keys(), loc="outside upper center", ncols=len(shown))
        figure.savefig(file, format="svg", metadata={"Date": None})


def _panel(panel: Axes, points: Sequence[Point], told: Told, column: str) -> None:
    values = []
    for (_, method, _), run in sorted(runs(points).items()):
        least = min(getattr(point, column) for point in points if getattr(point, column))
        x = [max(getattr(point, column), least / 2) for point in run]  # no step yet: at the edge
        y = [told.shown(point.value) for point in run]
        values.append(y)
        alone = "o" if len(run) == 1 else "."
        panel.plot(x, y, alone + "-", color=COLOURS[method], label=NAMES[method], lw=1, ms=4)
    highest = max(max(y) for y in values)
    if (best := _number(told.exact)) is not None:
        panel.axhline(best, color="black", lw=0.8, ls="--")
        highest = max(highest, best)
    # Values at the start of an agent's training are far below all that matters.
    lowest = min(max(y) for y in values)
    room = max(highest - lowest, 0.02 * abs(highest))
    panel.set_ylim(lowest - FLOOR * room, highest + 0.1 * room)
    panel.set_xscale("log")
    panel.spines[["top", "right"]].set_visible(False)


def _number(exact: str) -> float | None:
    """The best possible value, if it is known."""
    try:
        return float(exact.split(",")[0])
    except ValueError:
        return None
