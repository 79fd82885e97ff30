"""Contributions against the shortfall: the sweep of a mixture's weight."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from snapo.report.axes import number_axis
from snapo.report.drawing import draw, unit_above
from snapo.report.page import Chart, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, plus_minus
from snapo.report.theme import LIGHT

from .run import PensionRun, points, share

CAPTION = (
    "Every point is the best policy for its mixture of both aims on the validation paths, of all"
    " that were trained on the way up and down, and measured on the same fresh paths; bars are one"
    " standard error. Up and left is better. CVaR: mean of min(F − 1, 0) over the worst paths at"
    " the horizon. Efficient: no other point asks for less and leaves less of a shortfall."
)


def frontier(run: PensionRun) -> Section:
    """The efficient frontier of contributions and CVaR."""
    title, short = f"Efficient frontier ({run.measure})", "Frontier"
    rows = run.get("frontier.points", [])
    if not rows:
        text = "The case asks for no efficient frontier (`[frontier]`)."
        return Section("frontier", title, short, [Missing(text)])
    learned = run.get("frontier.learned")
    every = [*rows, *([learned] if learned else [])]
    scale, unit = run.size([each.get("contributions") for each in every])
    level = share(run.get("frontier.level"), 0)
    units = (f"Mean present value of contributions, {unit}", f"CVaR {level} of F − 1, points")
    first, last = rows[0], rows[-1]
    alt = (
        f"CVaR over contributions: from {points(first['cvar'])} points at"
        f" {run.large(first['contributions'])} to {points(last['cvar'])} at"
        f" {run.large(last['contributions'])}."
    )
    svg = draw("sweep", alt, lambda axes: _paint(axes, rows, learned, scale, units), 250)
    chart = Chart(svg, "The number at a point is the weight of contributions in its mixture.")
    body = [_row(each, share(each["share"], 0), scale) for each in rows]
    if learned:
        body.append(_row(learned, "Learned policy", scale))
    head = [("Weight of contributions", ""), ("PV contributions", unit), ("Error", unit)]
    head += [(f"CVaR {level}", "points"), ("Error", "points"), ("Median F", "%")]
    head += [("P(F < 1)", "%"), ("Efficient", "")]
    return Section("frontier", title, short, [chart, Table(head, body), Text(CAPTION, True)])


def _paint(axes: Axes, rows: list[dict], learned: dict | None, scale: float, units) -> None:
    """The sweep with its efficient points joined, and the learned policy."""
    best = sorted(
        (each for each in rows if each.get("efficient")), key=lambda e: e["contributions"]
    )
    axes.plot(*_places(best, scale), color=LIGHT["main"], linewidth=1.2)
    _dots(axes, rows, scale, "main", [share(each["share"], 0) for each in rows])
    if learned:
        _dots(axes, [learned], scale, "withdraw", ["Learned policy"], below=True)
    axes.margins(x=0.15, y=0.2)
    number_axis(axes.xaxis)
    number_axis(axes.yaxis)
    axes.set_xlabel(units[0])
    unit_above(axes, units[1])


def _row(each: dict, name: str, scale: float) -> tuple[str, ...]:
    error, tail = finite(each.get("contributions_error")), finite(each.get("cvar_error"))
    return (
        name,
        number((finite(each["contributions"]) or 0.0) / scale, 2),
        plus_minus(None if error is None else error / scale, 2),
        points(each["cvar"]),
        plus_minus(None if tail is None else 100 * tail, 2),
        points(each.get("median"), 1),
        points(each.get("underfunded"), 1),
        "" if each.get("efficient") is None else "yes" if each["efficient"] else "no",
    )


def _places(rows: Sequence[dict], scale: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.array([each["contributions"] for each in rows]) / scale
    return x, 100 * np.array([each["cvar"] for each in rows])


def _dots(axes: Axes, rows: Sequence[dict], scale: float, colour: str, names, below=False) -> None:
    x, y = _places(rows, scale)
    across = np.array([finite(each.get("contributions_error")) or 0.0 for each in rows]) / scale
    up = 100 * np.array([finite(each.get("cvar_error")) or 0.0 for each in rows])
    style = {"color": LIGHT[colour], "markersize": 6, "elinewidth": 1.0, "capsize": 2.5}
    axes.errorbar(x, y, xerr=across, yerr=up, fmt="o", **style)
    for name, right, high in zip(names, x, y):
        place = (6, -13 if below else 5)
        axes.annotate(name, (right, high), place, textcoords="offset points")
