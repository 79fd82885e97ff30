"""The fund over time: funding ratio, contributions, indexation, by year."""

from collections.abc import Sequence

import numpy as np

from snapo.report.bands import quantile_fan
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Table, Text
from snapo.report.quantity import number

from ..run import PensionRun, points, share, with_measure
from .paths import PATHS, Fan, PathTables

QUANTILES = ("p01", "p05", "p25", "p50", "p75", "p95", "p99")
HEAD = ("1 %", "5 %", "25 %", "50 %", "75 %", "95 %", "99 %")
SHOWN = 16  # rows of a table at most


def _thin(count: int) -> list[int]:
    """Positions of about SHOWN rows, the last among them."""
    step = max(1, -(-count // SHOWN))
    return [*range(0, count - 1, step), count - 1]


def funding(run: PensionRun, result: PathTables) -> Sequence[Block]:
    """The distribution of the funding ratio by year; nothing for a fund of pots."""
    if run.personal:
        return []
    table = result.by_year
    fan, years = table.funding, table.years
    scaled = {key: 100 * row for key, row in fan.items()}
    alt = (
        f"Funding ratio by year; the median goes from {share(fan['p50'][0])} to"
        f" {share(fan['p50'][-1])}, and at the end the 5 % and 95 % quantiles are "
        f"{share(fan['p05'][-1])} and {share(fan['p95'][-1])}."
    )
    svg = draw("funding-fan", alt, lambda axes: quantile_fan(axes, years, scaled, "%", 100.0), 270)
    caption = (
        "Assets divided by the liability on the case's basis, under the learned policy; "
        "the dotted line is 100 %."
    )
    rows = [
        (
            number(years[i], 0),
            *(points(fan[key][i], 1) for key in (*QUANTILES, "mean")),
            points(table.underfunded[i], 1),
            points(table.shortfall[i], 1),
        )
        for i in _thin(len(years))
    ]
    head = [("Year", ""), *((name, "%") for name in HEAD), ("Mean", "%"), ("P(F < 1)", "%")]
    head.append(("CVaR 95 %", "points"))
    text = "CVaR: mean of min(F − 1, 0) over the worst 5 % of paths"
    return [Chart(svg, caption), Table(head, rows, text, 1)]


def money(run: PensionRun, result: PathTables) -> Sequence[Block]:
    """Contributions and benefits by year."""
    table = result.by_year
    charts = [
        _paid(run, name, fan)
        for name, fan in (("contribution", table.contribution), ("benefit", table.benefit))
        if len(fan["p50"]) > 1
    ]
    fan = table.contribution
    scale = run.size(fan["p50"], fan["p99"])
    return [*charts, _table(fan, *scale, "Contributions by year")]


def _paid(run: PensionRun, name: str, fan: Fan) -> Chart:
    scale, unit = run.size(fan["p50"], fan["p99"])
    scaled = {key: row / scale for key, row in fan.items()}
    years, word = np.arange(1, len(fan["p50"]) + 1), f"{name.capitalize()}s"
    alt = f"{word} by year; the median goes from {run.large(fan['p50'][0])} to"
    alt += f" {run.large(fan['p50'][-1])}."
    unit = f"{unit} a year"
    svg = draw(f"{name}-fan", alt, lambda a: quantile_fan(a, years, scaled, unit, None), 200)
    return Chart(svg, f"{word} paid in each year, in money of that year.")


def indexation(run: PensionRun, result: PathTables) -> Sequence[Block]:
    """Indexation granted, by year and cumulated."""
    fan, total = result.by_year.indexation, result.by_year.cumulated
    if not np.any(fan["p99"] != fan["p01"]):
        return [Text(_certain(fan["p50"], total["p50"]))]
    years = np.arange(1, len(fan["p50"]) + 1)
    scaled = {key: 100 * row for key, row in total.items()}
    alt = f"Pensions by year in per cent of today's; the median ends at {share(total['p50'][-1])}."
    svg = draw("index-fan", alt, lambda a: quantile_fan(a, years, scaled, "% of today's", 100), 220)
    caption = "A pension of today after all increases and cuts, in money of that year."
    text = "Increases minus cuts, granted in each year"
    return [Chart(svg, caption), _table(fan, 0.01, "%", text)]


def _certain(item: np.ndarray, total: np.ndarray) -> str:
    """Increases of each year that are the same on all paths, and cumulated, as text."""
    if not np.any(item):
        return "The plan grants no increases."
    low, high = float(item.min()), float(item.max())
    size = share(low, 2) if high - low < 1e-12 else f"{share(low, 2)} to {share(high, 2)}"
    return (
        f"Pensions rise by {size} every year, equally on all paths: after {number(len(item), 0)} "
        f"years to {share(total[-1])} of today's."
    )


def _table(fan: Fan, scale: float, unit: str, caption: str) -> Table:
    rows = [
        (
            number(i + 1, 0),
            *(number(fan[key][i] / scale, 2) for key in (*QUANTILES, "mean")),
        )
        for i in _thin(len(fan["p50"]))
    ]
    head = [("Year", ""), *((name, unit) for name in HEAD), ("Mean", unit)]
    return Table(head, rows, caption, 1, folded=f"{caption}: all quantiles")


FUNDING = PATHS.section("funding", with_measure("Funding ratio by year"), "Funding ratio", funding)
CONTRIBUTIONS = PATHS.section(
    "contributions", with_measure("Contributions and benefits by year"), "Contributions", money
)
INDEXATION = PATHS.section(
    "indexation", with_measure("Indexation by year"), "Indexation", indexation
)
