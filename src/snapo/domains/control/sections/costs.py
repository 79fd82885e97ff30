"""The reward of an episode by part: what each state and each action costs."""

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.folder import Folder
from snapo.report.page import Chart, Section, Table
from snapo.report.quantity import decimals, measured, number, percent
from snapo.report.sections.distribution import words
from snapo.report.sections.lacking import lacking

TITLE, SHORT, ENDING = "Cost by part", "Costs", "_cost"


def costs(run: Folder) -> Section:
    """A ladder of the parts, and a table with standard errors."""
    found = [
        each
        for each in run.get("distribution", [])
        if each.get("paths") and each["name"].endswith(ENDING)
    ]
    if not found:
        return Section("costs", TITLE, SHORT, [lacking(run, "distribution")])
    found.sort(key=lambda each: -each["mean"])
    places = decimals([each["mean"] for each in found], 4)
    total = sum(each["mean"] for each in found)
    rungs = [
        charts.Rung(_name(each), each["mean"], number(each["mean"], places), each["standard_error"])
        for each in found
    ]
    alt = "; ".join(f"{rung.name} {rung.text}" for rung in rungs)
    svg = draw("costs-ladder", alt, lambda axes: charts.ladder(axes, rungs), 40 + 34 * len(rungs))
    rows = [
        (_name(each), *measured(each["mean"], each["standard_error"], places),
         percent(each["mean"] / total) if total else "")
        for each in found
    ]  # fmt: skip
    head = [("Part", ""), ("Mean of an episode", ""), ("", ""), ("Share", "")]
    caption = "Mean cost of an episode by part, under the trained policy."
    return Section("costs", TITLE, SHORT, [Chart(svg, caption), Table(head, rows, "Cost by part")])


def _name(each: dict) -> str:
    return words(each["name"].removesuffix(ENDING))
