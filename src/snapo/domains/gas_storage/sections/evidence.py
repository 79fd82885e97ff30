"""Why to believe the number: training history, certificate, assumptions and versions."""

import numpy as np

from ....report import charts
from ....report.drawing import draw
from ....report.page import Block, Chart, Facts, Mark, Missing, Section, Table, Text
from ....report.quantity import decimals, finite, long_date, number, percent, power, seconds
from .run import Run

HISTORY = (
    ("objective", "Smooth objective, training paths", "other", 0.8),
    ("exact", "Exact value, validation paths", "withdraw", 1.6),
    ("best", "Best so far", "main", 1.6),
)


def history(run: Run) -> Section:
    """The objective and the gradient norm over the steps of training."""
    title, short = "Training history", "Training"
    steps = run.column("history", "step")
    if steps is None:
        return Section("history", title, short, [Missing("This run has no history.csv.")])
    lines = [
        charts.Line(label, values, colour, width=width, step=name == "best")
        for name, label, colour, width in HISTORY
        if (values := run.column("history", name)) is not None
    ]
    norm, heat = (run.column("history", name) for name in ("gradient_norm", "temperature"))
    below = [
        charts.Line(label, np.where(values > 0, values, np.nan), colour, style)
        for values, label, colour, style in (
            (norm, "Gradient norm", "inject", "-"),
            (heat, "Temperature", "limit", "--"),
        )
        if values is not None and (values > 0).any()
    ]
    if not lines:
        text = "history.csv holds no objective to show."
        return Section("history", title, short, [Missing(text)])

    def paint(upper, lower=None):
        charts.trace(upper, steps, lines, run.currency)
        if lower is not None:
            charts.trace(lower, steps, below, "log scale", log=True)
        (lower or upper).set_xlabel("Training step")

    rows = (2.0, 1.0) if below else (1.0,)
    last = lines[-1].values[np.isfinite(lines[-1].values)][-1]
    alt = f"Training over {number(steps[-1], 0)} steps; {lines[-1].label.lower()} ends at "
    svg = draw("training", alt + run.money(last) + ".", paint, 330 if below else 230, rows)
    bad = run.column("history", "bad_paths")
    count = 0 if bad is None else float(np.nansum(bad))
    caption = (
        "The policy kept is the one with the best exact value on the validation paths, not the"
        f" last. Paths masked because a number was not finite: {number(count, 0)}."
    )
    return Section("history", title, short, [Chart(svg, caption)])


def checks(run: Run) -> list[tuple[str, bool]]:
    """(what was checked, whether it held) for every check of the certificate with a verdict."""
    tables = (("bump_check", "family"), ("feasibility", "limit"))
    return [
        (str(each.get(key, "")), bool(each["passed"]))
        for name, key in tables
        for each in run.get(f"certificate.{name}", [])
        if each.get("passed") is not None
    ]


def certificate(run: Run) -> Section:
    """Every test that this very run was put to."""
    title = "Certificate: why to believe this number"
    if not run.get("certificate"):
        text = "This run was not certified: details.json has no `certificate`."
        return Section("certificate", title, "Certificate", [Missing(text)])
    blocks: list[Block] = []
    if facts := _facts(run):
        blocks.append(Facts(facts))
    blocks += [_bump_check(run), _feasibility(run)]
    return Section("certificate", title, "Certificate", blocks, break_before=True)


def _facts(run: Run) -> list[tuple[str, str, str]]:
    facts = []
    gap = finite(run.get("certificate.smoothing_gap", run.result.get("smoothing_gap")))
    if gap is not None:
        value = finite(run.result.get("value"))
        share = f" ({percent(gap / abs(value), 2)})" if value else ""
        facts.append(("Smoothing gap", run.money(gap), f"exact less smooth{share}"))
    norm = finite(
        run.get("certificate.policy_gradient_norm", run.result.get("policy_gradient_norm"))
    )
    if norm is not None:
        facts.append(("Policy gradient norm", number(norm), "zero at an optimum"))
    left, right, error = (
        finite(run.get(f"certificate.homogeneity.{key}")) for key in ("left", "right", "error")
    )
    if left is not None and right is not None:
        places = decimals([left, right])
        note = f"value + costs: {run.money(right, places)}; difference {power(error)}"
        facts.append(("Σ forward × delta", run.money(left, places), note))
    facts += [
        (f"Control variate: {key.replace('_', ' ')}", _plain(value), "")
        for key, value in run.get("certificate.control_variate", {}).items()
    ]
    return facts


def _plain(value) -> str:
    return number(value) if finite(value) is not None else str(value)


def _bump_check(run: Run) -> Table | Missing:
    rows = run.get("certificate.bump_check", [])
    if not rows:
        return Missing("The adjoint was not checked against central differences in this run.")
    body = [
        (
            str(each.get("family", "")).replace("_", " ").capitalize(),
            _direction(each.get("inputs")),
            _verdict(each.get("passed"), "holds", "fails"),
            power(each.get("worst_error")),
            power(each.get("allowed")),
        )
        for each in rows
    ]
    head = [
        ("Family of inputs", ""),
        ("Bumped", ""),
        ("", ""),
        ("Worst error", run.currency),
        ("Allowed", run.currency),
    ]
    caption = "Adjoint against central differences, per unit of the input, on the same paths"
    return Table(head, body, caption, 3)


def _direction(inputs) -> str:
    """What was bumped: a direction in words, or how many inputs."""
    known = finite(inputs)
    return str(inputs or "") if known is None else number(known, 0)


def _verdict(passed, good: str, bad: str) -> Mark | str:
    return "not tried" if passed is None else Mark(bool(passed), good if passed else bad)


def _feasibility(run: Run) -> Table | Missing:
    rows = run.get("certificate.feasibility", [])
    if not rows:
        return Missing("The exact simulator's limits were not checked in this run.")
    body = [
        (
            str(each.get("limit", "")).replace("_", " ").capitalize(),
            _verdict(each.get("passed"), "holds", "violated"),
            power(each.get("worst")),
            number(each.get("path"), 0),
            _day(run, each.get("step")),
        )
        for each in rows
    ]
    head = [("Limit", ""), ("", ""), ("Smallest slack", run.volume), ("Path", ""), ("Day", "")]
    caption = "Feasibility over all paths and days, contract as written (slack: room to the limit)"
    return Table(head, body, caption, 2)


def _day(run: Run, step) -> str:
    known, when = finite(step), run.days
    if known is None or when is None or not 0 <= known < len(when):
        return number(known, 0)
    return long_date(when[int(known)])


def assumptions(run: Run) -> Section:
    """Model, notes, seeds, versions, timings, and what the units mean."""
    blocks: list[Block] = [
        Text(str(note)) for note in [run.get("model"), *run.get("notes", [])] if note
    ]
    if not blocks:
        blocks.append(Missing("The price model and the notes of the run are not in details.json."))
    if times := _times(run):
        blocks.append(Facts(times))
    blocks += [_made_with(run), _glossary(run)]
    title = "Assumptions, versions and units"
    return Section("assumptions", title, "Assumptions", blocks)


def _times(run: Run) -> list[tuple[str, str, str]]:
    times = run.get("seconds") or run.result.get("seconds") or {}
    known = [(name, each) for name, each in times.items() if finite(each) is not None]
    return [(name.capitalize(), seconds(each), "wall clock") for name, each in known]


def _made_with(run: Run) -> Table | Missing:
    engine = run.get("engine") or run.result.get("engine")
    name = engine.get("name") if isinstance(engine, dict) else engine
    reason = engine.get("reason") if isinstance(engine, dict) else None
    paths = run.get("paths") or run.result.get("paths") or {}
    seed = run.get("seed", run.result.get("seed"))
    rows = [("Engine", f"{name}: {reason}" if reason else name)] if name else []
    rows += [(f"Paths to {key}", number(each, 0)) for key, each in paths.items()]
    rows += [] if seed is None else [("Seed", str(seed))]
    versions = [f"{key} {each}" for key, each in run.get("versions", {}).items()]
    rows += [("Versions", ", ".join(versions))] if versions else []
    if not rows:
        return Missing("Engine, seed and versions are not in this run.")
    return Table([], rows, "How to get this number again", 2)


def _glossary(run: Run) -> Table:
    money, gas = run.currency or "currency", run.volume
    rows = [
        ("Value", money, "present value on the valuation date, contract as written"),
        ("Price", run.price, "forward and spot prices, trigger prices, undiscounted"),
        ("Volume", gas, "inventory, and volume per day for flows and rates"),
        ("Delta", gas, "change of value for a rise of 1 in one forward price, decisions held"),
        ("Discounted delta", gas, "delta of the present value; divided by the discount factor of"
         " the month's settlement it is the volume of futures"),
        ("Intrinsic", gas, "volumes of the best plan fixed today on the forward curve"),
        ("Smooth delta", gas, "through the smooth policy's own reaction; a diagnostic"),
        ("Volatility", "per √year", "of the logarithm of the price; 1 point is 0.01"),
        ("Standard error", "", "one standard deviation of the estimate; ± 1.96 of them is 95 %"),
        ("Cycles", "", "volume injected over the life, divided by the working volume"),
    ]  # fmt: skip
    return Table([("Term", ""), ("Unit", ""), ("Meaning", "")], rows, "Terms and units", 3)
