"""Estimation from data, and the policy in closed loop against the best fixed recipe."""

from typing import Any

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, percent, power, with_unit
from snapo.report.theme import LIGHT

from ..results.quality import not_handed_on
from . import pictures
from .run import Run


def estimation(run: Run) -> Section:
    """Fitted numbers with intervals, their correlation, and agreement with the data."""
    title, short = "Estimation", "Estimation"
    found = run.get("estimation")
    if not found:
        text = f"Nothing was fitted: {run.why_not('estimation', 'estimation')}."
        return Section("estimation", title, short, [Missing(text)])
    rows = []
    for i, name in enumerate(found["names"]):
        scale, offset = found["scales"][i]
        cells = (finite(found[key][i]) for key in ("start", "values", "low", "high"))
        own = (None if x is None else (x - offset) / scale for x in cells)
        unit = "" if found["units"][i] == "1" else found["units"][i]
        rows.append((name, unit, *map(number, own)))
    level = percent(found["level"], 0)
    head = [
        ("Number", ""),
        ("Unit", ""),
        ("Before", ""),
        ("Fitted", ""),
        (f"{level} from", ""),
        ("to", ""),
    ]
    blocks: list[Block] = [
        Text(
            f"Weighted least squares, {'converged' if found['converged'] else found['message']}: "
            f"chi² {number(found['chi2'])} at {number(found['freedom'], 0)} degrees of freedom, "
            f"condition {power(found['condition'])}; the best of {number(found['starts'], 0)} "
            f"starts. {_weighed(found)}"
        ),
        Table(head, rows, "Fitted numbers", 2),
    ]
    blocks += [Text(text) for text in not_handed_on(found)]
    names = found["names"]
    if len(names) > 1:
        body = [
            (name, *(number(x, 2) for x in row)) for name, row in zip(names, found["correlation"])
        ]
        blocks.append(Table([("", ""), *((n, "") for n in names)], body, "Correlation of the fit"))
    blocks.append(_agreement(found))
    blocks.append(Text(_use(found)))
    return Section("estimation", title, short, blocks)


def _agreement(found) -> Chart:
    """Fitted over measured, one panel for each unit of measure."""
    measured, fitted = (np.asarray(found[f"{key}_own"], float) for key in ("measured", "fitted"))
    units = np.asarray(found["state_unit"])
    every = list(dict.fromkeys(units.tolist()))

    def paint(*panels):
        for axes, unit in zip(panels, every):
            at = units == unit
            states = dict.fromkeys(s for s, here in zip(found["state"], at) if here)
            said = ", ".join(states) if len(states) <= 2 else f"{len(states)} states"
            own = with_unit("", unit)
            pictures.agreement(axes, measured[at], fitted[at], f"{said}{own}")

    svg = draw("agreement", "Fitted over measured values.", paint, 60 + 220 * len(every),
               [1.0] * len(every))  # fmt: skip
    worst = float(np.abs(np.asarray(found["residuals"], float)).max())
    caption = f"The largest residual is {number(worst, 1)} standard deviations of its measurement."
    return Chart(svg, caption)


def _weighed(found: dict[str, Any]) -> str:
    """How the covariance follows from the errors of the measurements."""
    scale, tail = number(found["scale"]), finite(found["tail"])
    if tail is None:
        return (
            "Errors are known up to a factor alone, so the covariance is chi² per degree of "
            f"freedom, {scale}, times that of the errors as they stand."
        )
    text = f"Chi² is exceeded by chance in {percent(tail)} of all cases"
    if found["scale"] == 1:
        return f"{text}; the covariance is that of the errors as they stand."
    return (
        f"{text}: the model does not describe the data, or their errors are too small. The "
        f"covariance was multiplied by chi² per degree of freedom, {scale}."
    )


def _use(found: dict[str, Any]) -> str:
    """How the fit is used from here on."""
    if not_handed_on(found):
        return "As not all numbers are identified, there is no fitted.csv to go on with."
    return (
        "The other parts of this run take the numbers of the case as they stand. fitted.csv of "
        "this run has the fitted ones with their covariance: copied beside the case and named "
        'there, fitted = "fitted.csv", they take the place of these numbers and of their '
        "[[uncertainty]]."
    )


def _goal(found: dict[str, Any]) -> Table:
    """What was made large, where that is not the probability itself."""
    rows = [
        ("Trained policy", number(found["objective"]), number(found["objective_error"])),
        ("Best fixed recipe", number(found["baseline_objective"]), ""),
    ]
    head = [("", ""), ("Goal", ""), ("Standard error", "")]
    return Table(head, rows, f"The goal: {found['goal']}")


def _rules(rules: list[dict[str, Any]]) -> list[Block]:
    """PI controllers beside the policy: their shares on the same batches, and their settings."""
    shares, settings = [], []
    for each in rules:
        cells = ("value", "standard_error", "policy_gain", "policy_gain_error", "recipe_gain",
                 "recipe_gain_error")  # fmt: skip
        shares.append((each["name"], *(percent(each[key], 2) for key in cells)))
        for sensor, gain, time in zip(each["sensors"], each["gains_own"], each["times"]):
            settings.append((each["name"], sensor, number(gain), number(time / 60)))
    head = ("", "All limits", "Standard error", "Policy less rule", "Standard error",
            "Recipe less rule", "Standard error")  # fmt: skip
    own = ("Rule", "Measured", "Gain, in the units of the domain", "Integral time, min")
    return [
        Table([(name, "") for name in head], shares, "Rules on the same batches, paired"),
        Table([(name, "") for name in own], settings, "Settings of the rules", 2),
        Text("First settings are those of the case or of its formula; a rule of that name without "
             "these words was trained from there, with its recipe, as long as the policy."),
    ]  # fmt: skip


def _course(found: dict[str, Any]) -> Chart:
    """A control over time: the policy's median and band, and both recipes."""
    minutes = np.asarray(found["time"], float) / 60
    lines = {
        "Policy, median": found["policy"],
        "Best fixed recipe": found["values"],
        "Recipe as given": found["given"],
    }

    def paint(axes):
        band = (np.asarray(found[key], float) for key in ("policy_low", "policy_high"))
        axes.fill_between(minutes, *band, color=LIGHT["inject-soft"], linewidth=0)
        each = [(name, np.asarray(values, float)) for name, values in lines.items()]
        pictures.curves(axes, minutes, each, with_unit(found["input"], found["unit"]))
        axes.set_xlabel("Time at the end of each decision, min")

    svg = draw(f"course-{found['input']}", "A control over time: the policy's median and its band "
               "over batches, the best fixed recipe, and the recipe as given.", paint,
               220)  # fmt: skip
    text = "The band holds the middle four fifths of the policy's decisions over batches."
    return Chart(svg, f"{found['input']}: {text}")


def _once(rows: list[dict[str, Any]]) -> Table:
    """What is decided once in a batch."""
    body = []
    for each in rows:
        low, high = number(each["policy_low"][0]), number(each["policy_high"][0])
        three = (number(each[key][0]) for key in ("policy", "values", "given"))
        body.append((with_unit(each["input"], each["unit"]), *three, f"{low} – {high}"))
    names = ("Decided once", "Policy, median", "Best fixed recipe", "As given", "Policy, 10–90 %")
    return Table([(name, "") for name in names], body, "Decisions of one number")


def closed_loop(run: Run) -> Section:
    """The policy against the best fixed recipe, on the same fresh batches."""
    title, short = "Closed loop", "Closed loop"
    found = run.get("closed_loop")
    if not found:
        text = f"No policy was trained: {run.why_not('closed loop', 'control')}."
        return Section("loop", title, short, [Missing(text)])
    gain, error = finite(found["gain"]), finite(found["gain_error"])
    sure = gain is not None and error is not None and gain > 3 * error
    rows = [
        ("Trained policy", percent(found["value"]), percent(found["standard_error"], 2)),
        ("Best fixed recipe", percent(found["baseline"]), percent(found["baseline_error"], 2)),
        ("Recipe as given", percent(found["given"]), percent(found["given_error"], 2)),
        ("Policy less best recipe", percent(gain), percent(error, 2)),
    ]
    head = [("", ""), ("Probability of all limits", ""), ("Standard error", "")]
    batches = number(found["paths"].get("evaluate"), 0)
    caption = f"On the same {batches} fresh batches, exact limits"
    blocks: list[Block] = [
        Text(str(run.result.get("verdict", ""))),
        Table(head, rows, caption),
        Table([], [("Gain above three standard errors", Mark(sure, "yes" if sure else "no"))],
              "", 2),
    ]  # fmt: skip
    if found.get("rules"):
        blocks += _rules(found["rules"])
    if run.result["references"].get("goal") is not None:
        blocks.append(_goal(found))
    blocks += [_course(each) for each in found["recipe"] if len(each["time"]) > 1]
    once = [each for each in found["recipe"] if len(each["time"]) == 1]
    if once:
        blocks.append(_once(once))
    steps = run.column("history", "step")
    best = run.column("history", "best")
    if steps is not None and best is not None and len(steps) > 1:

        def paint(axes):
            pictures.curves(axes, steps, [("Best so far", best)], "Objective, validation batches")
            axes.set_xlabel("Training step")

        svg = draw("training", "Objective over the steps of training.", paint, 200)
        blocks.append(Chart(svg, "The policy that was best on the validation batches is kept."))
    return Section("loop", title, short, blocks)
