"""Why to believe the numbers: training history, certificate, assumptions and versions."""

import numpy as np

from ....report import charts
from ....report.drawing import draw
from ....report.page import Block, Chart, Facts, Mark, Missing, Section, Table, Text
from ....report.quantity import finite, number, power, seconds
from ..units import name_of
from .run import Run

HISTORY = (
    ("objective", "Smooth objective, training paths", "other", 0.8),
    ("exact", "Exact value, validation paths", "withdraw", 1.6),
    ("best", "Best so far", "main", 1.6),
)


def checks(run: Run) -> list[tuple[str, bool]]:
    """(what was checked, whether it held) for every check with a verdict."""
    tables = (
        ("reconciliation.lines", "name", "ok"),
        ("reconciliation.martingale", "name", "ok"),
        ("certificate.bump_check", "family", "passed"),
        ("certificate.feasibility", "limit", "passed"),
    )
    return [
        (str(each.get(key, "")).replace("_", " "), bool(each[verdict]))
        for path, key, verdict in tables
        for each in run.get(path, [])
        if each.get(verdict) is not None and each.get("given", 0.0) is not None
    ]


def history(run: Run) -> Section:
    """The objective over the steps of training."""
    title, short = "Training history", "Training"
    steps = run.column("history", "step")
    lines = [
        charts.Line(label, values, colour, width=width, step=name == "best")
        for name, label, colour, width in HISTORY
        if (values := run.column("history", name)) is not None
    ]
    if steps is None or not lines:
        return Section("history", title, short, [Missing("This run has no history.csv.")])

    def paint(axes):
        charts.trace(axes, steps, lines, "objective")
        axes.set_xlabel("Training step")

    svg = draw("training", f"Training over {number(steps[-1], 0)} steps.", paint, 220)
    bad = run.column("history", "bad_paths")
    count = 0 if bad is None else float(np.nansum(bad))
    caption = (
        "The policy kept is the one with the best exact value on the validation paths. Paths masked"
        f" because a number was not finite: {number(count, 0)}."
    )
    return Section("history", title, short, [Chart(svg, caption)])


def certificate(run: Run) -> Section:
    """The adjoint against bumps, and every limit kept."""
    title = "Certificate: why to believe the sensitivities"
    if not run.get("certificate"):
        text = "This run was not certified: details.json has no `certificate`."
        return Section("certificate", title, "Certificate", [Missing(text)])
    gap = number(run.get("certificate.smoothing_gap"))
    norm = number(run.get("certificate.policy_gradient_norm"))
    blocks: list[Block] = [
        Facts(
            [
                ("Smoothing gap", gap, "exact less smooth, in the objective"),
                ("Policy gradient norm", norm, "zero at an optimum"),
            ]
        )
    ]
    bumps = run.get("certificate.bump_check", [])
    if bumps:
        rows = [
            (
                name_of(str(each["family"])),
                str(each.get("inputs", "")),
                _verdict(each.get("passed"), "holds", "fails"),
                power(each.get("worst_error")),
                power(each.get("allowed")),
            )
            for each in bumps
        ]
        head = [("Input", ""), ("Bumped", ""), ("", ""), ("Error", ""), ("Allowed", "")]
        text = "Adjoint against central differences on the same paths, decisions held"
        folded = f"Adjoint against bumps: {_count(bumps)}"
        blocks.append(Table(head, rows, text, 3, folded=folded))
    limits = run.get("certificate.feasibility", [])
    if limits:
        rows = [
            (
                str(each["limit"]).replace("_", " ").capitalize(),
                _verdict(each.get("passed"), "holds", "violated"),
                power(each.get("worst")),
                number(each.get("path"), 0),
                number((finite(each.get("step")) or 0) + 1, 0),
            )
            for each in limits
        ]
        head = [("Limit", ""), ("", ""), ("Smallest slack", ""), ("Path", ""), ("Step", "")]
        blocks.append(Table(head, rows, "Limits over all paths and steps, exact simulator", 2))
    return Section("certificate", title, "Certificate", blocks)


def _count(bumps: list[dict]) -> str:
    held = sum(bool(each.get("passed")) for each in bumps)
    return f"{held} of {len(bumps)} hold"


def _verdict(passed, good: str, bad: str) -> Mark | str:
    return "not tried" if passed is None else Mark(bool(passed), good if passed else bad)


def assumptions(run: Run) -> Section:
    """Model, notes, what is held, engine, seed and versions."""
    texts = [run.get("model"), *run.get("notes", [])]
    blocks: list[Block] = [Text(str(each)) for each in texts if each]
    held = run.get("held", [])
    if held:
        names = ", ".join(name_of(each).lower() for each in held)
        blocks.append(Text(f"Held fixed, without a sensitivity: {names}.", caveat=True))
    times = run.get("seconds", {})
    blocks.append(
        Facts([(name.capitalize(), seconds(each), "wall clock") for name, each in times.items()])
    )
    engine = run.get("engine", {})
    rows = [("Engine", f"{engine.get('name', '')}: {engine.get('reason', '')}")]
    rows += [(f"Paths to {key}", number(each, 0)) for key, each in run.get("paths", {}).items()]
    rows.append(("Seed", str(run.get("seed", ""))))
    versions = ", ".join(f"{key} {each}" for key, each in run.get("versions", {}).items())
    rows.append(("Versions", versions))
    blocks += [Table([], rows, "How to get these numbers again", 2), _glossary()]
    return Section("assumptions", "Assumptions, versions and terms", "Assumptions", blocks)


def _glossary() -> Table:
    rows = [
        ("P, Q", "real-world and risk-neutral scenarios; stands beside everything simulated"),
        ("Funding ratio F", "assets over liability, both at the same instant"),
        ("Certainty equivalent", "the sure funding ratio with the utility of the policy's own"),
        ("KR01, IE01", "change for +1 bp at one node of the nominal or break-even curve"),
        ("Hedge ratio", "rate sensitivity of assets and swaps over that of the liability"),
        ("Headroom", "rise in rates until the swaps' losses use up the eligible assets"),
        ("CVaR 95 %", "the mean of the worst 5 % of paths"),
        ("Standard error", "one standard deviation of an estimate; ± 1.96 of them is 95 %"),
    ]
    return Table([("Term", ""), ("Meaning", "")], rows, "Terms", 2)
