"""The sections on the evidence for a result: training, checks, origin, and the spread between
seeds."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from snapo.solver.learning.conditioning import PATHS, Growth
from snapo.solver.verdict.further import OPTIMUM

from . import charts
from .drawing import LIGHT, draw, unit_above
from .folder import RunFiles
from .page import Block, Chart, Facts, Headline, Mark, Missing, Section, Table, Text
from .quantity import MINUS, decimals, finite, measured, number, plus_minus, readable, seconds

HISTORY = (
    ("objective", "Smooth objective, training paths", "other", 0.8),
    ("exact", "Exact value, validation paths", "withdraw", 1.6),
    ("best", "Best so far", "main", 1.6),
)
BELOW = (
    ("gradient_norm", "Gradient norm", "inject", "-"),
    ("temperature", "Temperature", "limit", "--"),
)
RESTLESS = 2.0  # times its noise: a gradient that is not that of a policy at rest
BETTER = " does better"  # in a sentence on two rules, of which one should be taken
NAMED = 3  # checks that fail, on the first screen
TOTAL = "for all parts, without the writing of this page"


def check_marks(verdicts: Sequence[tuple[str, bool]], noun: str = "checks") -> list[Mark]:
    """The verdict on all checks, with the names of the checks that fail; no mark if there are no
    checks. `verdicts`: (name, whether the check holds); `noun`: the noun for a check.
    """
    failed = [name for name, holds in verdicts if not holds]
    if failed:
        more = f" and {len(failed) - NAMED} more" if len(failed) > NAMED else ""
        names = ", ".join(failed[:NAMED]) + more
        return [Mark(False, f"{len(failed)} of {len(verdicts)} {noun} fail: {names}")]
    if len(verdicts) == 1:
        return [Mark(True, f"the {noun.removesuffix('s')} holds")]
    return [Mark(True, f"all {len(verdicts)} {noun} hold")] if verdicts else []


def training_history(run: RunFiles, unit: str) -> Section:
    """Shows the objective, in its `unit`, and the gradient norm over the steps of training."""
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
        "The selected policy is the one with the best exact value on the validation paths; it "
        "need not be the last one. Paths left out because of non-finite numbers: "
        f"{number(count, 0)}."
    )
    return Section("history", title, short, [Chart(svg, caption)])


def notes(run: RunFiles) -> list[Text]:
    """Sentences that a reader of the value must know, for example on omitted paths, ruin or unused
    controls. The bound is not among them, because it is shown next to the value.
    """
    return [
        Text(re.sub(r"(?<![\w-])-(?=\d)", MINUS, str(item)), caveat=True)
        for item in run.result.notes
        if OPTIMUM not in str(item)
    ]


def with_verdicts(first: Section, run: RunFiles) -> Section:
    """The first section, in which a verdict on which rule is better is one of the marks, and not
    only a note further down."""
    texts = (str(item) for item in (run.result.verdict, *run.result.notes))
    sentences = list(dict.fromkeys(x for x in texts if BETTER in x))
    marks = [Mark(x.startswith("The policy"), x) for x in sentences]
    shown = {(item.text, item.caveat) for item in notes(run) if BETTER in item.text}
    blocks: list[Block] = []
    for block in first.blocks:
        if isinstance(block, Headline):
            block = replace(block, marks=[*block.marks, *marks])
        if not (isinstance(block, Text) and (block.text, block.caveat) in shown):
            blocks.append(block)
    if not any(isinstance(block, Headline) for block in blocks):
        return first
    return replace(first, blocks=blocks)


def gradient(run: RunFiles) -> list[tuple[str, str, str]]:
    """Whether training could still improve the policy, as its gradient shows; empty if the gradient
    is unknown."""
    norm, noise = run.result.policy_gradient_norm, run.result.policy_gradient_noise
    if norm is None or noise is None:
        return []
    if norm <= RESTLESS * noise or not noise:
        meaning = "small changes of the policy would not change the value beyond simulation noise"
        return [("Policy gradient", "no more than noise", meaning)]
    meaning = (
        f"norm {number(norm)}, noise {number(noise)}: small changes of the policy would still "
        "change the value"
    )
    if run.get("bound") is not None:
        meaning = f"{meaning}; the upper bound limits this change"
    return [("Policy gradient", f"{number(norm / noise, 1)} times its noise", meaning)]


def verdict(passed: Any, valid: str, invalid: str, undecided: str = "not tried") -> Mark | str:
    """A mark with its text; `undecided` for a check that was not run."""
    return undecided if passed is None else Mark(bool(passed), valid if passed else invalid)


def spent(run: RunFiles) -> dict[str, float]:
    """Wall-clock seconds by name, without the time to write the page."""
    available = run.get("seconds") or run.result.seconds
    return {name: x for name, x in available.items() if finite(x) is not None and name != "report"}


def times(run: RunFiles) -> list[Facts]:
    """The time of the run, part by part."""
    facts = [
        (name.capitalize(), seconds(item), TOTAL if name == "total" else "wall clock")
        for name, item in spent(run).items()
    ]
    return [Facts(facts)] if facts else []


def made_with(run: RunFiles) -> Table | Missing:
    """Shows engine, paths, seed and versions."""
    engine = run.get("engine") or run.result.engine
    name = engine.get("name") if isinstance(engine, dict) else engine
    reason = engine.get("reason") if isinstance(engine, dict) else None
    paths = run.get("paths") or run.result.paths
    seed = run.get("seed", run.result.seed)
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


PARTS, STYLES = 6, (":", "--", "-.")  # parts of the state that are drawn, and their lines


def history(run: RunFiles) -> Section:
    """Shows the objective and the gradient norm over the steps of training, and the adjoints by
    step."""
    result = training_history(run, run.unit)
    return replace(result, blocks=[*result.blocks, *_adjoints(run)])


def _adjoints(run: RunFiles) -> list[Block]:
    """Shows the norms of adjoints by step and part of the state, if training measured them."""
    steps = run.column("adjoints", "step")
    if steps is None or steps.size < 2:
        return []
    available = [("usual", "Typical path", "main"), ("largest", "Largest norm", "withdraw")]
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
        f"Norm of the adjoint before every step, on {PATHS} training paths. It was measured when "
        f"training last checked whether it can differentiate the whole horizon; if the case sets "
        f"clip, window or keep, it is that of the trained policy. Parts of the state are shown as "
        f"root mean squares over these paths. All numbers are in adjoints.csv."
    )
    return [Chart(svg, caption), Text(_growth(run, leaves))]


def _growth(run: RunFiles, leaves: list[str]) -> str:
    """The growth of the adjoints, and the settings of backpropagation."""
    names = ("usual", "largest", *leaves)
    columns = (run.column("adjoints", name) for name in names)
    usual, largest, *parts = (() if column is None else tuple(column) for column in columns)
    summary = Growth(0, usual, largest, dict(zip(leaves, parts))).describe()
    window, clip, keep = run.result.window, run.result.clip, run.result.keep
    if window is not None:
        summary += f" Training backpropagated through windows of {window} steps."
    if clip is not None:
        summary += f" At the end of training each path's adjoint was bounded at {number(clip)}."
    if keep is not None and keep < 1:
        summary += f" Every backward step passed on only the share {number(keep)} of the adjoint."
    return summary


def making(run: RunFiles) -> Section:
    """The section with the state of every part, times, engine, seed and versions."""
    blocks: list[Block] = [_parts(run), *_times(run), made_with(run)]
    return Section("making", "Parts, times and versions", "Versions", blocks)


def _times(run: RunFiles) -> list[Facts]:
    """The times of the stages of training and the total time; the times of the parts are in their
    table."""
    results = [
        (name.capitalize(), seconds(item), TOTAL if name == "total" else "wall clock")
        for name, item in spent(run).items()
        if name not in run.parts
    ]
    return [Facts(results)] if results else []


def _parts(run: RunFiles) -> Table:
    rows = [
        (
            readable(name),
            verdict(state.state == "done", "done", state.state),
            state.note,
            seconds(state.seconds),
        )
        for name, state in run.parts.items()
    ]
    head = [("Part", ""), ("", ""), ("Note", ""), ("Time", "")]
    return Table(head, rows, "Parts of this run", 3)


MAX_SEEDS = 40  # seeds in the picture; the table has all


def seeds(run: RunFiles) -> Section:
    """Shows the value of every seed with its interval, and the spread next to the Monte Carlo
    error."""
    result = run.get("by_seed")
    errors = [finite(result.get(name)) for name in ("standard_error", "deviation")]
    values = [row["value"] for row in result["rows"]]
    digits = decimals([error for error in errors if error] or values, 2)
    table = _table(result, digits)
    displayed = [row for row in result["rows"] if finite(row["value"]) is not None][:MAX_SEEDS]
    blocks: list[Any] = [Text(_sentence(result, run.unit, digits)), table]
    if len(displayed) > 1:
        blocks.insert(1, _picture(result, displayed, run.unit, digits))
    return Section("seeds", "Between seeds", "Seeds", blocks)


def _sentence(result: dict[str, Any], unit: str, digits: int) -> str:
    mean, worst, best = (number(result[name], digits) for name in ("mean", "worst", "highest"))
    spread = number(result["deviation"], digits)
    half = plus_minus(result["standard_error"], digits)
    paths = number(result["paths"], 0)
    text = (
        f"The case was trained with {len(result['rows'])} seeds. On {paths} common paths, the "
        f"values of their policies are {mean} {unit} on average, {worst} for the worst policy and "
        f"{best} for the best policy"
    ).replace("  ", " ")
    if finite(result["deviation"]) is not None:
        text += (
            f"; their standard deviation is {spread}. The simulation error of the mean is {half}; "
            "it comes from these paths and is common to all seeds"
        )
    return f"{text}. This page shows the run with seed {result['best']}."


def _picture(
    result: dict[str, Any], displayed: list[dict[str, Any]], unit: str, digits: int
) -> Chart:
    """Differences from the best policy, which have much smaller errors than the values
    themselves."""
    names = [str(row["seed"]) for row in displayed]
    below = [-row["below_best"] for row in displayed]
    errors = [charts.INTERVAL * (finite(row["below_best_error"]) or 0.0) for row in displayed]

    def paint(axes, _=None):
        line = {"ecolor": LIGHT["withdraw"], "elinewidth": 1.6, "capsize": 4.0}
        axes.errorbar(
            range(len(displayed)), below, yerr=errors, fmt="o", color=LIGHT["main"], **line
        )
        axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
        axes.set_xticks(range(len(displayed)), names)
        axes.set_xlim(-0.6, len(displayed) - 0.4)
        axes.set_xlabel("Seed")
        unit_above(axes, unit)

    summary = "; ".join(f"seed {name} {number(item, digits)}" for name, item in zip(names, below))
    caption = (
        "The value of the policy of each seed minus the value of the best policy, on common "
        "paths, with 95 % intervals."
    )
    return Chart(
        draw("seeds-picture", f"Differences from the best policy: {summary}.", paint, 220), caption
    )


def _table(result: dict[str, Any], digits: int) -> Table:
    head = [
        ("Seed", ""), ("Verdict", ""), ("Value", ""), ("", ""), ("Below the best", ""), ("", ""),
        ("Time", ""),
    ]  # fmt: skip
    rows = []
    for row in result["rows"]:
        best = row["seed"] == result["best"]
        verdict = [row["status"], row["convergence"], "" if row["within"] else "breaks a limit"]
        below = ("the best", "") if best else (row["below_best"], row["below_best_error"])
        rows.append(
            (
                str(row["seed"]),
                ", ".join(filter(None, verdict)),
                *measured(row["value"], row["standard_error"], digits),
                *(below if best else measured(*below, digits)),
                seconds(row["seconds"]),
            )
        )
    selected = frozenset(i for i, row in enumerate(result["rows"]) if row["seed"] == result["best"])
    return Table(head, rows, "Seeds on common paths", 2, selected)
