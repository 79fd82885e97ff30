"""The decision of today, for every inventory that might be in store."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from snapo.problem.problem import Problem
from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Section, Table
from snapo.report.quantity import finite, long_date, number, quantity
from snapo.solver.solution import Solution
from snapo.study.chapter import Number
from snapo.study.study import Setup, Today

from ..contract.records import StorageCase
from ..policy.network import StoragePolicy
from ..policy.triggers import Triggers, decide, triggers
from ..setup import case_of, policy_of
from .run import StorageRun

ROWS = 16  # of the table, about


@dataclass(frozen=True)
class LevelDecision:
    """The decision of the first day at one inventory and the forward price.

    - `inject_below`, `withdraw_above`: trigger prices; `action`: "inject", "withdraw" or "hold";
      `volume`: the volume of the action, not negative.
    """

    inventory: Number = np.nan
    inject_below: Number = np.nan
    withdraw_above: Number = np.nan
    action: str = ""
    volume: Number = np.nan


@dataclass(frozen=True)
class FirstDecision(LevelDecision):
    """The decision at the inventory in store, and in `ladder` at other inventories over the
    reachable range.

    - `date`: the ISO date of the first decision; `spot`: the spot price of the decision.
    - `marginal_value`: the marginal value of one more unit in store, from the adjoint; NaN without
      sensitivities.
    """

    date: str = ""
    spot: Number = np.nan
    marginal_value: Number = np.nan
    ladder: tuple[LevelDecision, ...] = ()


def levels_of(schedule) -> tuple[float, np.ndarray]:
    """The inventory in store, and other inventories in the interval that is feasible on the first
    day."""
    here = float(schedule.constants.inventory)
    low, high = schedule.steps.low[0], schedule.steps.high[0]
    return here, np.unique(np.append(np.linspace(low, high, 11), here))


def first_decision(
    problem: Problem,
    case: StorageCase,
    solution: Solution,
    levels: tuple[float, np.ndarray],
    prices: Triggers,
) -> FirstDecision:
    """The decision of the first day; `levels`: see `levels_of`; `prices`: the trigger prices at
    these levels."""
    now, ladder = _decisions(problem, policy_of(solution), levels, prices)
    # The network's price of gas is exact at the trigger only; the adjoint's everywhere.
    marginal = float("nan")
    if solution.sensitivities is not None:
        marginal = float(solution.sensitivities.of(case.contract.inventory.name).value.sum())
    return replace(
        now,
        date=case.days[0].isoformat(),
        spot=float(problem.schedule.steps.forward[0]),
        marginal_value=marginal,
        ladder=tuple(ladder),
    )


def _decisions(
    problem: Problem, policy: StoragePolicy, levels: tuple[float, np.ndarray], prices: Triggers
) -> tuple[FirstDecision, list[LevelDecision]]:
    """The decision at the inventory in store, and at every level."""
    here, stock = levels
    decided = decide(problem, policy, 0, stock)
    net = decided.injection - decided.withdrawal
    rows = [
        (
            float(stock[i]),
            float(prices.injection[i]),
            float(prices.withdrawal[i]),
            "inject" if net[i] > 0 else "withdraw" if net[i] < 0 else "hold",
            float(abs(net[i])),
        )
        for i in range(len(stock))
    ]
    now = rows[int(np.flatnonzero(stock == here)[0])]
    return FirstDecision(*now), [LevelDecision(*row) for row in rows]


def today(setup: Setup, policy: StoragePolicy) -> Today:
    """The decision of the first day at the forward price, by inventory in store, for the live
    page."""
    problem, case = setup.problem, case_of(setup)
    here, stock = levels_of(problem.schedule)
    prices = triggers(problem, policy, np.zeros(len(stock), int), stock)
    now, ladder = _decisions(problem, policy, (here, stock), prices)
    gas, price = case.volume_unit, f"{case.currency}/{case.volume_unit}"
    facts = [
        ("spot", float(problem.schedule.steps.forward[0]), price),
        ("inventory", now.inventory, gas),
        ("inject below", now.inject_below, price),
        ("withdraw above", now.withdraw_above, price),
    ]
    columns = [
        ("inventory", gas), ("action", ""), ("volume", gas),
        ("inject below", price), ("withdraw above", price),
    ]  # fmt: skip
    rows = [[x.inventory, x.action, x.volume, x.inject_below, x.withdraw_above] for x in ladder]
    volume = f" {quantity(now.volume, gas)}" if now.volume else ""
    return Today(f"{now.action}{volume} on {long_date(case.days[0])}", facts, columns, rows)


def ladder(run: StorageRun, now: FirstDecision | None) -> Section:
    """The decision of today for every inventory, as a picture and as a table."""
    title, short = "Today's decision by inventory", "Today"
    if now is None or not now.ladder:
        return Section("today", title, short, [why_missing(run, "profile")])
    blocks: list[Block] = []
    if finite(now.spot) is not None and finite(now.inventory) is not None:
        blocks.append(_chart(run, now))
    rows = [
        (number(x.inventory, 0), x.action, number(abs(x.volume), 1), number(x.inject_below, 2),
         number(x.withdraw_above, 2))
        for x in _thinned(now.ladder)
    ]  # fmt: skip
    head = [
        ("Inventory", run.volume), ("Action at spot", ""), ("Volume", run.volume),
        ("Inject below", run.price), ("Withdraw above", run.price),
    ]  # fmt: skip
    blocks.append(Table(head, rows, "The decision at today's spot price, by inventory", 2))
    return Section("today", title, short, blocks)


def _chart(run: StorageRun, now: FirstDecision) -> Chart:
    level, low, high = np.array(
        [(x.inventory, x.inject_below, x.withdraw_above) for x in now.ladder]
    ).T
    names, units = ("inject", "hold", "withdraw"), (f"Inventory, {run.volume}", run.price)
    here = (now.inventory, now.spot)
    svg = draw(
        "today-ladder",
        f"Trigger prices by inventory. At {run.gas(here[0])} and a spot of "
        f"{quantity(here[1], run.price, 2)} the action is {now.action or 'not specified'}.",
        lambda axes: charts.regions(axes, level, low, high, here, names, units),
        height=240,
    )
    caption = (
        "Below the lower line the policy injects, and above the upper line it withdraws. Between "
        "the lines costs and fuel exceed the gain of a trade."
    )
    return Chart(svg, caption)


def _thinned(rows: Sequence[LevelDecision]) -> list[LevelDecision]:
    """Every n-th row so that about `ROWS` are left, and the last."""
    selected = list(rows[:: max(1, math.ceil(len(rows) / ROWS))])
    return selected if selected[-1] is rows[-1] else [*selected, rows[-1]]
