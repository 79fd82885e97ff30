"""Why to believe the number, and how to get it again."""

from dataclasses import replace

import numpy as np

from snapo.solver.learning.conditioning import PATHS, Growth

from .. import charts, evidence
from ..drawing import draw
from ..folder import RunFiles
from ..page import Block, Chart, Facts, Section, Table, Text
from ..quantity import number, readable, seconds

PARTS, STYLES = 6, (":", "--", "-.")  # parts of the state that are drawn, and their lines


def history(run: RunFiles) -> Section:
    """The objective and the gradient norm over the steps of training, and adjoints by step."""
    result = evidence.history(run, run.unit)
    return replace(result, blocks=[*result.blocks, *_adjoints(run)])


def _adjoints(run: RunFiles) -> list[Block]:
    """The norms of adjoints by step and part of the state, where training measured them."""
    steps = run.column("adjoints", "step")
    if steps is None or steps.size < 2:
        return []
    available = [("usual", "Usual path", "main"), ("largest", "Largest path", "withdraw")]
    leaves = [name for name in run.adjoints if name not in ("step", "usual", "largest")]
    available += [(name, f"State {name!r}", "limit") for name in leaves[:PARTS]]
    lines = []
    for position, (name, label, colour) in enumerate(available):
        values = run.column("adjoints", name)
        if values is not None and (values > 0).any():
            style = STYLES[(position - 2) % len(STYLES)] if position > 1 else "-"
            displayed = np.where(values > 0, values, np.nan)
            lines.append(charts.Line(label, displayed, colour, style))
    if not lines:
        return []

    def paint(axes, _=None):
        charts.trace(axes, steps, lines, "log scale", log=True)
        axes.set_xlabel(str(run.get("step", "step")).capitalize())

    maximum = float(np.nanmax(lines[-1].values if len(lines) < 2 else lines[1].values))
    alt = f"Norm of the adjoint before each of {steps.size} steps; at most {number(maximum)}."
    svg = draw("adjoints", alt, paint, 230)
    caption = (
        f"Norm of the adjoint before every step, on {PATHS} paths of training, at the moment when "
        "it was last in doubt whether the whole horizon can be differentiated, or of the trained "
        "policy where the case says how to go back: the parts of the state are root mean squares "
        "over these paths. All are in adjoints.csv."
    )
    return [Chart(svg, caption), Text(_growth(run, leaves))]


def _growth(run: RunFiles, leaves: list[str]) -> str:
    """By how much the adjoints grow, and how training went back."""
    names = ("usual", "largest", *leaves)
    columns = (run.column("adjoints", name) for name in names)
    usual, largest, *parts = (() if column is None else tuple(column) for column in columns)
    summary = Growth(0, usual, largest, dict(zip(leaves, parts))).describe()
    window, clip, keep = (run.result.get(name) for name in ("window", "clip", "keep"))
    if window is not None:
        summary += f" Training went back through windows of {window} steps."
    if clip is not None:
        summary += f" At its end training bounded each path's own adjoint at {number(clip)}."
    if keep is not None and keep < 1:
        summary += f" A share of {number(keep)} of it went on at every step back."
    return summary


def making(run: RunFiles) -> Section:
    """The state of every part, times, engine, seed and versions."""
    blocks: list[Block] = [_parts(run), *_times(run), evidence.made_with(run)]
    return Section("making", "Parts, times and versions", "Versions", blocks)


def _times(run: RunFiles) -> list[Facts]:
    """The stages of the training and the total; the parts have theirs in their table."""
    results = [
        (name.capitalize(), seconds(item), evidence.TOTAL if name == "total" else "wall clock")
        for name, item in evidence.spent(run).items()
        if name not in run.parts
    ]
    return [Facts(results)] if results else []


def _parts(run: RunFiles) -> Table:
    rows = [
        (
            readable(name),
            evidence.verdict(state.get("state") == "done", "done", str(state.get("state"))),
            str(state.get("note") or ""),
            seconds(state.get("seconds")),
        )
        for name, state in run.parts.items()
    ]
    head = [("Part", ""), ("", ""), ("Note", ""), ("Time", "")]
    return Table(head, rows, "Parts of this run", 3)
