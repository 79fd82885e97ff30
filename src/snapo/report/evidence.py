"""What every run with a trained policy shows as evidence: its training, its checks, its making."""

import re
from typing import Any

import numpy as np

from . import charts
from .drawing import draw
from .folder import RunFiles
from .page import Chart, Facts, Mark, Missing, Section, Table, Text
from .quantity import MINUS, finite, number, seconds

HISTORY = (
    ("objective", "Smooth objective, training paths", "other", 0.8),
    ("exact", "Exact value, validation paths", "withdraw", 1.6),
    ("best", "Best so far", "main", 1.6),
)
BELOW = (
    ("gradient_norm", "Gradient norm", "inject", "-"),
    ("temperature", "Temperature", "limit", "--"),
)
TOTAL = "of all parts, before this page"


def history(run: RunFiles, unit: str) -> Section:
    """The objective, in its `unit`, and the gradient norm over the steps of training."""
    title, short = "Training history", "Training"
    steps = run.column("history", "step")
    lines = [
        charts.Line(label, values, colour, width=width, step=name == "best")
        for name, label, colour, width in HISTORY
        if (values := run.column("history", name)) is not None
    ]
    if steps is None or not lines:
        return Section("history", title, short, [Missing("This run has no history.csv.")])
    below = [
        charts.Line(label, np.where(values > 0, values, np.nan), colour, style)
        for name, label, colour, style in BELOW
        if (values := run.column("history", name)) is not None and (values > 0).any()
    ]

    def paint(upper, lower=None):
        charts.trace(upper, steps, lines, unit)
        if lower is not None:
            charts.trace(lower, steps, below, "log scale", log=True)
        (lower or upper).set_xlabel("Training step")

    rows = (2.0, 1.0) if below else (1.0,)
    last = number(lines[-1].values[np.isfinite(lines[-1].values)][-1])
    alt = f"Training over {number(steps[-1], 0)} steps; {lines[-1].label.lower()} ends at {last}"
    svg = draw("training", f"{alt} {unit}.", paint, 330 if below else 230, rows)
    invalid = run.column("history", "bad_paths")
    count = 0 if invalid is None else float(np.nansum(invalid))
    caption = (
        "The policy kept is the one with the best exact value on the validation paths, not the"
        f" last. Paths left out because a number was not finite: {number(count, 0)}."
    )
    return Section("history", title, short, [Chart(svg, caption)])


def notes(run: RunFiles) -> list[Text]:
    """Sentences on what a reader of the value must know: paths left out, ruin, unused controls."""
    return [
        Text(re.sub(r"(?<![\w-])-(?=\d)", MINUS, str(item)), caveat=True)
        for item in run.result.get("notes") or ()
    ]


def gradient(run: RunFiles) -> list[tuple[str, str, str]]:
    """The norm of the policy's gradient with its noise, as a fact; none where it is not known."""
    norm = finite(run.result.get("policy_gradient_norm"))
    noise = finite(run.result.get("policy_gradient_noise"))
    if norm is None:
        return []
    available = "" if noise is None else f"; noise of {number(noise)} is taken off"
    return [("Policy gradient norm", number(norm), f"zero at an optimum{available}")]


def verdict(passed: Any, valid: str, invalid: str, undecided: str = "not tried") -> Mark | str:
    """A mark with its word; a check that was not made says so."""
    return undecided if passed is None else Mark(bool(passed), valid if passed else invalid)


def spent(run: RunFiles) -> dict[str, float]:
    """Wall-clock seconds by name; "total" is without the writing of reports, which no page can know
    of itself."""
    available = run.get("seconds") or run.result.get("seconds") or {}
    table = {name: item for name, item in available.items() if finite(item) is not None}
    page = table.pop("report", 0.0)
    return table | {"total": table["total"] - page} if "total" in table else table


def times(run: RunFiles) -> list[Facts]:
    """What the run took, part by part."""
    facts = [
        (name.capitalize(), seconds(item), TOTAL if name == "total" else "wall clock")
        for name, item in spent(run).items()
    ]
    return [Facts(facts)] if facts else []


def made_with(run: RunFiles) -> Table | Missing:
    """Engine, paths, seed and versions."""
    engine = run.get("engine") or run.result.get("engine")
    name = engine.get("name") if isinstance(engine, dict) else engine
    reason = engine.get("reason") if isinstance(engine, dict) else None
    paths = run.get("paths") or run.result.get("paths") or {}
    seed = run.get("seed", run.result.get("seed"))
    rows = [("Engine", f"{name}: {reason}" if reason else name)] if name else []
    roles = run.get("solution.roles", {})
    rows += [(f"Paths of the {role}", text) for role, text in roles.items()]
    if not roles:
        rows += [(f"Paths to {key}", number(path, 0)) for key, path in paths.items()]
    rows += [] if seed is None else [("Seed", str(seed))]
    versions = [f"{key} {item}" for key, item in run.get("versions", {}).items()]
    rows += [("Versions", ", ".join(versions))] if versions else []
    if not rows:
        return Missing("Engine, seed and versions are not in this run.")
    return Table([], rows, "How to get these numbers again", 2)
