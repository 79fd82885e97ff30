"""The storage over time, and the trades against it: curve and trigger prices, inventory, deltas."""

import numpy as np

from snapo.report import charts
from snapo.report.axes import days as date_numbers
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table
from snapo.report.quantity import (
    SPACE,
    array,
    decimals,
    finite,
    long_month,
    number,
    quantity,
)
from snapo.report.sections.lacking import lacking

from .run import Run

SIGN = (
    "A positive delta is a month in which the storage is long (it will withdraw): the hedge sells"
    " that volume of futures; a negative delta is bought."
)


def curve(run: Run) -> Section:
    """The forward curve between the prices below which to inject and above which to withdraw."""
    title, short = "Forward curve and trigger prices", "Curve"
    prices, when = run.numbers("forward", "forward"), run.days
    if prices is None or when is None:
        return Section("curve", title, short, [lacking(run, "profile")])
    place = date_numbers(when)
    lines = []
    for key, label, colour in TRIGGERS:
        values = run.numbers(f"trigger_{key}", f"trigger_{key}")
        if values is not None:
            lines.append(charts.Line(label, values, colour, width=1.3))
    lines.append(charts.Line("Forward price", prices, "ink", width=2.0, step=True))
    low, high = np.nanmin(prices), np.nanmax(prices)
    alt = (
        f"Forward price by day, from {quantity(low, run.price, 2)} to"
        f" {quantity(high, run.price, 2)}, with the trigger prices of injection and withdrawal."
    )
    svg = draw("curve-lines", alt, lambda axes: charts.lines(axes, place, lines, run.price))
    caption = (
        "Trigger prices are undiscounted spot prices at the expected inventory of the day: the"
        " policy injects when spot is below the blue line and withdraws above the orange one."
    )
    blocks: list[Block] = [Chart(svg, caption)]
    if len(lines) == 1:
        blocks.append(Missing("The trigger prices by day are not in this run."))
    return Section("curve", title, short, blocks)


TRIGGERS = (
    ("withdrawal", "Withdraw above", "withdraw"),
    ("injection", "Inject below", "inject"),
)


def inventory(run: Run) -> Section:
    """Expected inventory with its 5-95 % band, inside the reachable and the allowed ones."""
    title, short = "Inventory against its limits", "Inventory"
    mean, when = run.numbers("inventory.mean", "inventory_mean"), run.days
    if mean is None or when is None:
        return Section("inventory", title, short, [lacking(run, "profile")])
    place = date_numbers(when)
    ends = np.append(place, place[-1] + 1)[: len(mean)]  # [T+1]: the start of every day and the end
    band = [run.numbers(f"inventory.{name}", f"inventory_{name}") for name in ("p05", "p95")]
    low, high = (None if each is None else each[: len(mean)] for each in band)
    reach, limits = (_pair(run, name, len(mean)) for name in ("reachable", "limits"))
    flow = run.numbers("flow.mean", "flow_mean")

    def paint(stock, daily=None):
        charts.fan(stock, ends, mean, low, high, run.volume, reach=reach, limits=limits)
        if daily is not None and flow is not None:
            # Withdrawals point up, as they earn; the run counts injections as positive.
            names = ("Withdrawal, mean", "Injection, mean")
            charts.signed_strip(daily, place, -flow, run.daily, names)

    rows = (1.0,) if flow is None else (2.0, 1.0)
    alt = (
        f"Mean inventory by day with a 5 to 95 % band; it starts at {run.gas(mean[0])}, peaks at"
        f" {run.gas(np.nanmax(mean))} on {when[int(np.nanargmax(mean[: len(when)]))]} and ends at"
        f" {run.gas(mean[-1])}."
    )
    svg = draw("inventory-fan", alt, paint, 260 if flow is None else 370, rows)
    caption = (
        "Grey is every inventory from which the contract can still be met; the policy cannot leave"
        " it. Below, the mean flow of each day: withdrawals up, injections down."
    )
    return Section("inventory", title, short, [Chart(svg, caption)])


def _pair(run: Run, name: str, length: int):
    low, high = run.numbers(f"{name}.low"), run.numbers(f"{name}.high")
    return None if low is None or high is None else (low[:length], high[:length])


def monthly(run: Run) -> Section:
    """Deltas by delivery month with intervals, against the intrinsic volumes."""
    title, short = "Deltas by delivery month", "Deltas"
    rows = run.get("deltas_monthly", [])
    values = array([each.get("undiscounted") for each in rows])
    if values is None:
        return Section("deltas", title, short, [lacking(run, "deltas")])
    paint = month_painter(run, rows, values)
    parts = [
        f"{long_month(each.get('month'))} {number(value, 0)}"
        for each, value in zip(rows, values, strict=True)
    ]
    alt = f"Bars of the delta per delivery month in {run.volume}: " + ", ".join(parts) + "."
    svg = draw("deltas-by-month", alt, paint, 280)
    caption = (
        f"Volumes to trade in futures (undiscounted). {SIGN} Whiskers: 95 % interval, sampling"
        " error and error of the policy together. Hatched: how far the delta still moved in the"
        " last half of training."
    )
    table = _month_table(run, rows)
    return Section("deltas", title, short, [Chart(svg, caption), table])


def month_painter(run: Run, rows, values):
    """Paints the monthly deltas into one `Axes`; also used by the picture that stands alone."""
    labels = _month_labels([each.get("month") for each in rows])
    halves = array([_half(row) for row in rows])
    intrinsic = array([row.get("intrinsic") for row in rows])
    options = {
        "names": ("Long: sell", "Short: buy"),
        "half": None if halves is None else np.nan_to_num(halves),
        "moved": array([row.get("moved") for row in rows]),
        "compare": None if intrinsic is None else ("Intrinsic plan", intrinsic),
    }
    return lambda axes: charts.signed_bars(axes, labels, values, run.volume, **options)


def _half(row: dict) -> float | None:
    """Half the width of the interval of an undiscounted delta."""
    low, high = finite(row.get("undiscounted_low")), finite(row.get("undiscounted_high"))
    return None if low is None or high is None else (high - low) / 2


def _month_labels(months: list) -> list[str]:
    """ "Apr", or every second, third … where there are many; the year where a new one begins."""
    step = next((step for step in (1, 2, 3, 6, 12) if len(months) <= 18 * step), 24)
    labels, last = [""] * len(months), ""
    for i in range(0, len(months), step):
        name, _, year = long_month(months[i]).partition(SPACE)
        labels[i] = name if year == last else f"{name}\n{year}"
        last = year
    return labels


def _month_table(run: Run, rows) -> Table:
    columns = ("undiscounted", "intrinsic", "moved", "discounted", "smooth")
    places = decimals([row.get(name) for row in rows for name in columns], 4)
    shown = ("undiscounted", "undiscounted_low", "undiscounted_high")
    body = [
        (
            long_month(row.get("month")),
            _trade(row.get("undiscounted")),
            *(number(row.get(name), places) for name in shown),
            number(row.get("intrinsic"), places),
            number(row.get("moved"), places, sign=True),
            number(row.get("discounted"), places),
            *(number(row.get(name), max(places, 1)) for name in ("sampling", "policy")),
            number(row.get("smooth"), places),
        )
        for row in rows
    ]
    total = [sum(finite(row.get(name)) or 0.0 for row in rows) for name in columns]
    whole, plan, _, discounted, _ = (number(x, places) for x in total)
    body.append(("All months", "", whole, "", "", plan, "", discounted, "", "", ""))
    names = ("Delta", "95 % low", "high", "Intrinsic", "Moved", "Discounted", "± sampling",
             "± policy", "Smooth")  # fmt: skip
    head = [("Delivery", ""), ("Hedge", ""), *((name, run.volume) for name in names)]
    return Table(head, body, texts=2, strong=frozenset([len(body) - 1]))


def _trade(volume) -> str:
    known = finite(volume)
    if not known:
        return ""
    return "sell" if known > 0 else "buy"


def daily(run: Run) -> Section:
    """The same deltas by delivery day: one thin bar a day."""
    title, short = "Deltas by delivery day", "Daily deltas"
    when, values = run.days, run.numbers("deltas_daily.undiscounted", "delta_undiscounted")
    if values is None or when is None:
        return Section("daily", title, short, [lacking(run, "deltas")])
    place, discounted = date_numbers(when), run.numbers("deltas_daily.discounted")
    low, high = run.numbers("deltas_daily.low"), run.numbers("deltas_daily.high")
    half = None
    if low is not None and high is not None and discounted is not None:
        factor = np.divide(values, discounted, out=np.ones_like(values), where=discounted != 0)
        half = np.nan_to_num((high - low) / 2 * np.abs(factor))
    plan = run.numbers("deltas_daily.intrinsic")
    compare = None if plan is None else ("Intrinsic plan", plan)
    names = ("Long: sell", "Short: buy")
    svg = draw(
        "deltas-by-day",
        f"Delta of each of {len(values)} delivery days, from {run.gas(np.nanmin(values))} to"
        f" {run.gas(np.nanmax(values))}.",
        lambda axes: charts.signed_strip(
            axes, place, values, run.volume, names, half=half, compare=compare
        ),
        height=220,
    )
    caption = (
        "One sensitivity per day of the forward curve, all from one adjoint pass; whiskers are"
        " 95 % intervals. The numbers are in sensitivities.csv."
    )
    return Section("daily", title, short, [Chart(svg, caption)])
