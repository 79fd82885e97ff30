"""The fund over time: funding ratio, contributions, indexation, by year."""

from collections.abc import Sequence

import numpy as np

from snapo.report.bands import Swing, quantile_fan, tornado
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table, Text
from snapo.report.quantity import number

from .run import PensionRun, points, share

QUANTILES = ("p01", "p05", "p25", "p50", "p75", "p95", "p99")
HEAD = ("1 %", "5 %", "25 %", "50 %", "75 %", "95 %", "99 %")
SHOWN = 16  # rows of a table at most


def _fan(run: PensionRun, name: str) -> dict[str, np.ndarray] | None:
    found = run.get(f"by_year.{name}")
    if not found:
        return None
    return {key: np.array([np.nan if v is None else v for v in row]) for key, row in found.items()}


def _thin(count: int) -> list[int]:
    """Positions of about SHOWN rows, the last among them."""
    step = max(1, -(-count // SHOWN))
    kept = list(range(0, count, step))
    return kept if kept[-1] == count - 1 else [*kept, count - 1]


def funding(run: PensionRun) -> Section:
    """The distribution of the funding ratio by year."""
    title, short = f"Funding ratio by year ({run.measure})", "Funding ratio"
    fan, years = _fan(run, "funding"), run.numbers("by_year.years")
    if fan is None or years is None:
        text = "The distribution of the funding ratio is not in this run."
        return Section("funding", title, short, [Missing(text)])
    scaled = {key: 100 * row for key, row in fan.items()}
    alt = (
        f"Funding ratio by year; the median goes from {share(fan['p50'][0])} to"
        f" {share(fan['p50'][-1])}, with 5 to 95 % of paths between {share(fan['p05'][-1])} and"
        f" {share(fan['p95'][-1])} at the end."
    )
    svg = draw("funding-fan", alt, lambda axes: quantile_fan(axes, years, scaled, "%", 100.0), 270)
    caption = "Assets over liability on the case's basis, under the learned policy; dotted: 100 %."
    under, tail = run.get("by_year.underfunded", []), run.get("by_year.shortfall", [])
    rows = [
        (
            number(years[i], 0),
            *(points(fan[key][i], 1) for key in QUANTILES),
            points(fan["mean"][i], 1),
            points(under[i], 1) if i < len(under) else "",
            points(tail[i], 1) if i < len(tail) else "",
        )
        for i in _thin(len(years))
    ]
    head = [("Year", ""), *((name, "%") for name in HEAD), ("Mean", "%"), ("P(F < 1)", "%")]
    head.append(("CVaR 95 %", "points"))
    text = "CVaR: mean of min(F − 1, 0) over the worst 5 % of paths"
    return Section("funding", title, short, [Chart(svg, caption), Table(head, rows, text, 1)])


def attribution(run: PensionRun) -> Section:
    """The change of the funding ratio from today to the horizon, in parts that add up to it."""
    title, short = f"Parts of the change of the funding ratio ({run.measure})", "Attribution"
    rows = run.get("attribution.rows", [])
    if not rows:
        text = "The change of the funding ratio was not attributed in this run."
        return Section("attribution", title, short, [Missing(text)])
    kept = [each for each in rows if any(each[key] for key in ("assets", "liability"))]
    swings = [
        Swing(each["name"], 100 * each["mean"], points(each["mean"], 2, True)) for each in kept
    ]
    alt = "Mean effects on the funding ratio. " + "; ".join(f"{s.name}: {s.text}" for s in swings)
    height = 40 + 22 * len(swings)
    svg = draw("attribution", alt, lambda axes: tornado(axes, swings, "points of F"), height)
    change, start = run.get("attribution.change", {}), run.get("attribution.start")
    sums = {key: sum(each[key] for each in rows) for key in ("assets", "liability", "mean")}
    lines = [*kept, sums | {"name": "All parts"}, change | {"name": "Change of F"}]
    body = [_part(each) for each in lines]
    head = [("", ""), ("Through assets", "points"), ("Through liability", "points")]
    head += [("Mean effect", "points"), ("Standard deviation", "points")]
    caption = (
        f"From {share(start)} today to the mean {run.horizon}: means over paths under the learned"
        " policy. In every month assets and liability are moved in both orders and the mean of the"
        " two is taken; the liability's own parts come in the order benefits, accrual, interest,"
        " rates, mortality, indexation. Mortality: departures from the table; indexation: beyond"
        " the part valued already. The parts add up to the change of F on every path."
    )
    table = Table(head, body, "", 1, strong=frozenset([len(body) - 2, len(body) - 1]))
    return Section("attribution", title, short, [Chart(svg, caption), table])


def _part(each: dict) -> tuple[str, ...]:
    moved = (each.get(key) for key in ("assets", "liability", "mean"))
    signed = ("" if value is None else points(value, 2, True) for value in moved)
    deviation = each.get("deviation")
    return each["name"], *signed, "" if deviation is None else points(deviation, 2)


def variance(run: PensionRun) -> Section:
    """The variance of the final funding ratio without each source of risk."""
    title, short = f"Sources of the variance ({run.measure})", "Variance"
    rows = run.get("variance", [])
    if not rows:
        text = "The variance of the funding ratio was not divided by source in this run."
        return Section("variance", title, short, [Missing(text)])
    body = [
        (
            str(each["source"]),
            points(each["mean"], 1),
            points(each["deviation"], 1),
            points(each.get("explained"), 0),
        )
        for each in rows
    ]
    head = [("", ""), ("Mean F", "%"), ("Standard deviation", "points")]
    head.append(("Variance gone", "%"))
    caption = (
        f"The funding ratio {run.horizon} on the same paths with the volatilities of one source"
        " at zero, the trained policy deciding. Shares need not add up to 100 %: sources offset"
        " each other. A negative share hedged the rest."
    )
    table = Table(head, body, "", 1, strong=frozenset([0]))
    return Section("variance", title, short, [table, Text(caption, caveat=True)])


def money(run: PensionRun) -> Section:
    """Contributions and benefits by year."""
    title, short = f"Contributions and benefits by year ({run.measure})", "Contributions"
    fans = [(name, _fan(run, name)) for name in ("contribution", "benefit")]
    known = [(name, fan) for name, fan in fans if fan is not None]
    if not known:
        text = "Contributions by year are not in this run."
        return Section("contributions", title, short, [Missing(text)])
    blocks: list[Block] = []
    for name, fan in known:
        scale, unit = run.size(fan["p50"], fan["p99"])
        scaled = {key: row / scale for key, row in fan.items()}
        years = np.arange(1, len(fan["p50"]) + 1)
        if len(years) < 2:
            continue
        word = f"{name.capitalize()}s"
        alt = f"{word} by year; the median goes from {run.large(fan['p50'][0])} to"
        alt += f" {run.large(fan['p50'][-1])}."
        svg = draw(
            f"{name}-fan",
            alt,
            lambda axes, scaled=scaled, unit=unit, years=years: quantile_fan(
                axes, years, scaled, f"{unit} a year", None
            ),
            200,
        )
        blocks.append(Chart(svg, f"{word} paid in each year, in money of that year."))
    name, fan = known[0]
    blocks.append(_table(fan, *run.size(fan["p50"], fan["p99"]), f"{name.capitalize()}s by year"))
    return Section("contributions", title, short, blocks)


def indexation(run: PensionRun) -> Section:
    """Indexation granted, by year and cumulated."""
    title, short = f"Indexation by year ({run.measure})", "Indexation"
    fan, total = _fan(run, "indexation"), _fan(run, "cumulated")
    if fan is None or total is None:
        return Section("indexation", title, short, [Missing("Indexation is not in this run.")])
    if not np.any(fan["p99"] != fan["p01"]):
        return Section("indexation", title, short, [Text(_certain(fan["p50"], total["p50"]))])
    years = np.arange(1, len(fan["p50"]) + 1)
    scaled = {key: 100 * row for key, row in total.items()}
    alt = f"Pensions by year in per cent of today's; the median ends at {share(total['p50'][-1])}."
    svg = draw("index-fan", alt, lambda a: quantile_fan(a, years, scaled, "% of today's", 100), 220)
    caption = "A pension of today after all increases and cuts, in money of that year."
    text = "Increases less cuts, granted in each year"
    blocks: list[Block] = [Chart(svg, caption), _table(fan, 0.01, "%", text)]
    return Section("indexation", title, short, blocks)


def _certain(each: np.ndarray, total: np.ndarray) -> str:
    """Increases of each year that are the same on all paths, and cumulated, in words."""
    if not np.any(each):
        return "The plan grants no increases."
    low, high = float(each.min()), float(each.max())
    size = share(low, 2) if high - low < 1e-12 else f"{share(low, 2)} to {share(high, 2)}"
    return (
        f"Pensions rise by {size} every year, on all paths alike: after {number(len(each), 0)} "
        f"years to {share(total[-1])} of today's."
    )


def _table(fan: dict[str, np.ndarray], scale: float, unit: str, caption: str) -> Table:
    rows: Sequence = [
        (
            number(i + 1, 0),
            *(number(fan[key][i] / scale, 2) for key in QUANTILES),
            number(fan["mean"][i] / scale, 2),
        )
        for i in _thin(len(fan["p50"]))
    ]
    head = [("Year", ""), *((name, unit) for name in HEAD), ("Mean", unit)]
    return Table(head, rows, caption, 1, folded=f"{caption}: all quantiles")
