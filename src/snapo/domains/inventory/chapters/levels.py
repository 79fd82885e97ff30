"""The trained rule of an item: the order and the order-up-to level for each stock."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import counted, plural
from snapo.problem.policy import Policy
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.report.drawing import LIGHT, draw, legend_above, number_axis, unit_above
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Table, Text
from snapo.report.quantity import number
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import Setup, StudyRun, Today

from ..item.records import InventoryCase
from ..setup import case_of
from .about import CaseSummary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = 41  # of the stock
SHARES = (0.5, 1.0, 1.5)  # of the usual amount on its way
COLOURS, STYLES = ("main", "withdraw", "limit"), ("-", "--", ":")
LINES = 25  # of the table


@dataclass(frozen=True)
class OrderCurve:
    """The rule at every stock, for one amount of outstanding orders that is spread over the lead
    time.

    - `orders` [n]: the orders; `levels` [n]: the sum of stock, outstanding orders and the new
      order; NaN if nothing is ordered.
    """

    coming: Number
    orders: Floats
    levels: Floats


@dataclass(frozen=True)
class OrderCurves:
    """The rule by `stock` [n], in the first period that counts."""

    stock: Floats
    curves: tuple[OrderCurve, ...]

    @property
    def places(self) -> int:
        """The number of decimals for amounts; 0 if all amounts are whole."""
        amounts = [self.stock]
        for curve in self.curves:
            amounts += [np.array([curve.coming]), curve.orders, curve.levels]
        finite = np.concatenate([x[np.isfinite(x)] for x in amounts])
        return 0 if (finite == np.round(finite)).all() else 1


def measure(run: StudyRun) -> OrderCurves:
    """Measures the orders at several stocks, without outstanding orders and with usual amounts of
    them, in the first period that counts."""
    setup, case = run.setup, case_of(run.setup)
    now = at(setup.problem.schedule.steps, case.warm_up)
    stock = stocks(case, float(now["level"]))
    usual = np.asarray(now["mean"], np.float64)[1 : max(case.item.lead_time, 1)]
    curves, policy = [], run.solution.policy
    assert policy is not None
    for share in SHARES if len(usual) else (1.0,):
        coming = share * usual
        coming = np.round(coming) if case.item.integer else coming
        amounts = orders(setup, policy, stock, coming, case.warm_up)
        levels = np.where(amounts > 0, stock + coming.sum() + amounts, np.nan)
        curves.append(OrderCurve(float(coming.sum()), amounts, levels))
    return OrderCurves(stock, tuple(curves))


def stocks(case: InventoryCase, level: float) -> np.ndarray:
    """Stocks from zero to somewhat above the level; if demand waits, from below zero."""
    low = 0.0 if case.item.lost else -level / 2
    grid = np.linspace(low, 1.2 * level, POINTS)
    return np.unique(np.round(grid)) if case.item.integer else grid


def orders(
    setup: Setup, policy: Policy, stock: np.ndarray, coming: np.ndarray, period: int
) -> np.ndarray:
    """[n] the exact orders of the rule at these stocks in this period, counted from 0."""
    problem, case = setup.problem, case_of(setup)
    simulator, fixed = problem.simulator, case.item.fixed
    schedule = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), problem.schedule)
    now = at(schedule.steps, period)

    @jax.jit
    def of(stock):
        state = {"stock": stock}
        if case.item.lead_time > 1:
            state["coming"] = jnp.asarray(coming, jnp.float32)
        observation = simulator.observe(schedule.constants, now, state)
        action = policy(observation, Exact())
        return action[1] * action[2] if fixed else action[0]

    return np.asarray(jax.vmap(of)(jnp.asarray(stock, jnp.float32)), np.float64)


def today(setup: Setup, policy: Policy) -> Today:
    """The order in the first period, with which the warm-up begins: the stock and the outstanding
    orders of the case belong to this period."""
    case, constants = case_of(setup), setup.problem.schedule.constants
    stock, coming = float(constants["stock"]), np.asarray(constants["coming"], np.float64)
    order = float(orders(setup, policy, np.array([stock]), coming, 0)[0])
    facts = [
        ("stock", stock, case.unit),
        ("on its way", float(coming.sum()), case.unit),
        ("order", order, case.unit),
    ]
    text = f"order {counted(order, case.unit)}" if order > 0 else "order nothing"
    return Today(text, facts)


def show(run: RunFiles, result: OrderCurves) -> Sequence[Block]:
    """Shows orders by stock, with a curve for every amount of outstanding orders."""
    case = CaseSummary.of(run)
    unit, curves, digits = case.item_unit, result.curves, result.places
    names = [f"{number(curve.coming, digits)} {plural(unit)} on their way" for curve in curves]
    if len(curves) == 1:
        names = ["Order"]

    def paint(axes: "Axes") -> None:
        for name, curve, colour, style in zip(names, curves, COLOURS, STYLES):
            axes.plot(result.stock, curve.orders, color=LIGHT[colour], linestyle=style, label=name)
        axes.set_xlabel(f"Stock, {plural(unit)}")
        number_axis(axes.xaxis, 8)
        number_axis(axes.yaxis)
        unit_above(axes, f"Order, {plural(unit)}")
        legend_above(axes)

    alt = f"Orders fall from {number(curves[0].orders[0], 1)} at the smallest stock to 0."
    caption = "The order of the trained rule for each stock, in the first period that counts" + (
        ", if outstanding orders are spread evenly over the lead time."
        if (case.lead_time or 0) > 1
        else "."
    )
    text = (
        "A base-stock rule is a line with slope −1. If demand is lost, the best rule falls less "
        "steeply, and the orders that arrive last have the largest effect on it."
        if case.lost
        else "The level up to which the rule orders is the sum of stock, outstanding orders and "
        "the new order."
    )
    chart = Chart(draw("rule", alt, paint, 270.0), caption)
    return [chart, Text(text), _table(result, unit)]


def _table(result: OrderCurves, unit: str) -> Table:
    stock, curves, digits = result.stock, result.curves, result.places
    head = [("Stock", unit)]
    for curve in curves:
        coming = f" ({number(curve.coming, digits)} on their way)" if len(curves) > 1 else ""
        head += [(f"Order{coming}", unit), ("Order-up-to level", unit)]
    lines = np.linspace(0, len(stock) - 1, min(LINES, len(stock))).round().astype(int)
    rows = []
    for i in np.unique(lines):
        amounts = [stock[i], *(x for curve in curves for x in (curve.orders[i], curve.levels[i]))]
        rows.append([number(x, digits) for x in amounts])
    return Table(head, rows, "Orders and order-up-to levels", 0, folded="All numbers")


LEVELS = Chapter(
    "order-up-to levels", "The rule: how much to order", OrderCurves, measure, show,
    short="Rule", key="levels",
)  # fmt: skip
