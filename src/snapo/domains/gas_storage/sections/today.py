"""The decision of today for every inventory that might be in store."""

import math

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Section, Table
from snapo.report.quantity import array, finite, number, quantity
from snapo.report.sections.lacking import lacking

from .run import Run

LADDER_KEYS = ("inventory", "inject_below", "withdraw_above")


def today(run: Run) -> Section:
    """The decision of today for every inventory, as a picture and as a table."""
    title, short = "Today's ladder over inventory", "Today"
    rungs = run.get("today.ladder", [])
    columns = [array([each.get(key) for each in rungs]) for key in LADDER_KEYS] if rungs else []
    if not rungs or columns[0] is None:
        return Section("today", title, short, [lacking(run, "profile")])
    level, low, high = columns
    blocks: list[Block] = []
    spot, store = finite(run.get("today.spot")), finite(run.get("today.inventory"))
    if low is not None and high is not None and spot is not None and store is not None:
        blocks.append(_ladder_chart(run, level, low, high, (store, spot)))
    rows = [_ladder_row(each) for each in _thinned(rungs, 16)]
    head = [
        ("Inventory", run.volume),
        ("Action at spot", ""),
        ("Volume", run.volume),
        ("Inject below", run.price),
        ("Withdraw above", run.price),
    ]
    blocks.append(Table(head, rows, "The decision at today's spot price, by inventory", 2))
    return Section("today", title, short, blocks)


def _ladder_chart(run: Run, level, low, high, here) -> Chart:
    names, units = ("inject", "hold", "withdraw"), (f"Inventory, {run.volume}", run.price)
    svg = draw(
        "today-ladder",
        f"Trigger prices over inventory. At {run.gas(here[0])} and a spot of "
        f"{quantity(here[1], run.price, 2)} the action is {run.get('today.action', 'not given')}.",
        lambda axes: charts.regions(axes, level, low, high, here, names, units),
        height=240,
    )
    caption = (
        "Below the lower line the policy injects, above the upper line it withdraws, between them"
        " costs and fuel are worth more than the trade."
    )
    return Chart(svg, caption)


def _ladder_row(each: dict) -> tuple[str, ...]:
    prices = [number(each.get(key), 2) for key in LADDER_KEYS[1:]]
    volume = finite(each.get("volume"))
    moved = None if volume is None else abs(volume)
    return (number(each["inventory"], 0), str(each.get("action", "")), number(moved, 1), *prices)


def _thinned(rows: list, count: int) -> list:
    """Every n-th row so that about `count` are left, and the last."""
    kept = rows[:: max(1, math.ceil(len(rows) / count))]
    return kept if kept[-1] is rows[-1] else [*kept, rows[-1]]
