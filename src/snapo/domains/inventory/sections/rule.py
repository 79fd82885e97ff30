"""The trained rule in a picture and a table: how much to order at which stock."""

import numpy as np
from matplotlib.axes import Axes

from snapo.report.axes import number_axis
from snapo.report.drawing import draw, legend_above, unit_above
from snapo.report.folder import Folder
from snapo.report.page import Chart, Section, Table, Text
from snapo.report.quantity import array, number
from snapo.report.sections.lacking import lacking
from snapo.report.theme import LIGHT

COLOURS, STYLES = ("main", "withdraw", "limit"), ("-", "--", ":")
LINES = 25  # of the table


def rule(run: Folder) -> Section:
    """Orders by stock, a curve for every amount on its way."""
    title, short = "The rule: how much to order", "Rule"
    stock, curves = array(run.get("levels.stock")), run.get("levels.curves", [])
    if stock is None or not curves:
        return Section("rule", title, short, [lacking(run, "order-up-to levels")])
    unit = str(run.get("item_unit", ""))
    placed = [np.asarray(each["orders"], float) for each in curves]
    places = _places(run, stock)
    names = [f"{number(each['coming'], places)} {unit}s on their way" for each in curves]
    lead = run.get("lead_time", 0)
    if len(curves) == 1:
        names = ["Order"]

    def paint(axes: Axes) -> None:
        for name, values, colour, style in zip(names, placed, COLOURS, STYLES):
            axes.plot(stock, values, color=LIGHT[colour], linestyle=style, label=name)
        axes.set_xlabel(f"Stock, {unit}s")
        number_axis(axes.xaxis, 8)
        number_axis(axes.yaxis)
        unit_above(axes, f"Order, {unit}s")
        legend_above(axes)

    alt = f"Orders fall from {number(placed[0][0], 1)} at the least stock to none."
    caption = "The order of the trained rule by the stock, in the first period that counts" + (
        ", the orders on their way spread evenly over the lead time." if lead > 1 else "."
    )
    words = (
        "A base-stock rule is a falling line with slope −1. Where demand is lost, the best rule "
        "falls less steeply, and reacts most to the orders that arrive last."
        if run.get("lost")
        else "The level up to which the rule orders is stock, orders on their way and the order "
        "together."
    )
    blocks = [Chart(draw("rule", alt, paint, 270.0), caption), Text(words), _table(run, stock)]
    return Section("rule", title, short, blocks)


def _places(run: Folder, stock: np.ndarray) -> int:
    """Decimals of amounts: none where all of them are whole."""
    amounts = [stock]
    for each in run.get("levels.curves", []):
        amounts += [array([each["coming"]]), array(each["orders"]), array(each["levels"])]
    known = [each[np.isfinite(each)] for each in amounts if each is not None]
    return 0 if all((each == np.round(each)).all() for each in known) else 1


def _table(run: Folder, stock: np.ndarray) -> Table:
    curves, unit = run.get("levels.curves", []), str(run.get("item_unit", ""))
    head, places = [("Stock", unit)], _places(run, stock)
    for each in curves:
        coming = f" ({number(each['coming'], places)} on their way)" if len(curves) > 1 else ""
        head += [(f"Order{coming}", unit), ("Up to", unit)]
    chosen = np.unique(np.linspace(0, len(stock) - 1, min(LINES, len(stock))).round().astype(int))
    rows = []
    for i in chosen:
        cells = [number(stock[i], places)]
        for each in curves:
            cells += [number(each["orders"][i], places), number(each["levels"][i], places)]
        rows.append(cells)
    return Table(head, rows, "Orders and the level up to which they go", 0, folded="All numbers")
