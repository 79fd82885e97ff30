"""Estimation from data, and the policy in closed loop against the best fixed recipe."""

from typing import Any

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, percent, power

from . import pictures
from .run import Run


def estimation(run: Run) -> Section:
    """Fitted numbers with intervals, their correlation, and agreement with the data."""
    title, short = "Estimation", "Estimation"
    found = run.get("estimation")
    if not found:
        text = "Nothing was fitted: the case has no [estimation] with data of this process."
        return Section("estimation", title, short, [Missing(text)])
    rows = [
        (name, number(start), number(value), number(low), number(high))
        for name, start, value, low, high in zip(
            *(found[key] for key in ("names", "start", "values", "low", "high"))
        )
    ]
    level = percent(found["level"], 0)
    head = [("Number", ""), ("Before", ""), ("Fitted", ""), (f"{level} from", ""), ("to", "")]
    blocks: list[Block] = [
        Text(
            f"Weighted least squares, {'converged' if found['converged'] else found['message']}: "
            f"chi² {number(found['chi2'])} at {number(found['freedom'], 0)} degrees of freedom, "
            f"condition {power(found['condition'])}."
        ),
        Table(head, rows, "Fitted numbers, in the units of the computation"),
    ]
    blocks += [Text(text) for text in found["unidentified"]]
    names = found["names"]
    if len(names) > 1:
        body = [
            (name, *(number(x, 2) for x in row)) for name, row in zip(names, found["correlation"])
        ]
        blocks.append(Table([("", ""), *((n, "") for n in names)], body, "Correlation of the fit"))
    blocks.append(_agreement(found))
    return Section("estimation", title, short, blocks)


def _agreement(found) -> Chart:
    """Measured and fitted in standard deviations of the data, so that states share one plot."""
    measured, fitted = (np.asarray(found[key], float) for key in ("measured", "fitted"))

    def paint(axes):
        pictures.agreement(axes, measured, fitted, "units of the computation")

    svg = draw("agreement", "Fitted over measured values.", paint)
    worst = float(np.abs(np.asarray(found["residuals"], float)).max())
    caption = f"The largest residual is {number(worst, 1)} standard deviations of its measurement."
    return Chart(svg, caption)


def _goal(found: dict[str, Any]) -> Table:
    """What was made large, where that is not the probability itself."""
    rows = [
        ("Trained policy", number(found["objective"]), number(found["objective_error"])),
        ("Best fixed recipe", number(found["baseline_objective"]), ""),
    ]
    head = [("", ""), ("Goal", ""), ("Standard error", "")]
    return Table(head, rows, f"The goal: {found['goal']}")


def closed_loop(run: Run) -> Section:
    """The policy against the best fixed recipe, on the same fresh batches."""
    title, short = "Closed loop", "Closed loop"
    found = run.get("closed_loop")
    if not found:
        text = "No policy was trained: the case has no [control], or its part failed."
        return Section("loop", title, short, [Missing(text)])
    gain, error = finite(found["gain"]), finite(found["gain_error"])
    sure = gain is not None and error is not None and gain > 3 * error
    rows = [
        ("Trained policy", percent(found["value"]), percent(found["standard_error"], 2)),
        ("Best fixed recipe", percent(found["baseline"]), percent(found["baseline_error"], 2)),
        ("Difference, same batches", percent(gain), percent(error, 2)),
    ]
    head = [("", ""), ("Probability of all limits", ""), ("Standard error", "")]
    batches = number(found["paths"].get("evaluate"), 0)
    blocks: list[Block] = [
        Table(head, rows, f"On {batches} fresh batches, exact limits"),
        Table([], [("Gain above three standard errors", Mark(sure, "yes" if sure else "no"))],
              "", 2),
    ]  # fmt: skip
    if run.result["references"].get("goal") is not None:
        blocks.append(_goal(found))
    steps = run.column("history", "step")
    best = run.column("history", "best")
    if steps is not None and best is not None and len(steps) > 1:

        def paint(axes):
            pictures.curves(axes, steps, [("Best so far", best)], "Objective, validation batches")
            axes.set_xlabel("Training step")

        svg = draw("training", "Objective over the steps of training.", paint, 200)
        blocks.append(Chart(svg, "The policy that was best on the validation batches is kept."))
    return Section("loop", title, short, blocks)
