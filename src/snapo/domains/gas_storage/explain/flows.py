"""The days between two valuation dates: the flows planned on the first date, the actual flows, and
their cash."""

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from snapo.case.csv import FileReference, read_rows, rising_dates
from snapo.case.error import CaseError
from snapo.case.table import TableContext
from snapo.problem.problem import Problem

from ..contract.records import StorageCase
from ..history.rule import DatedRule, decided, spot_filter
from ..policy.network import StoragePolicy
from ..prices.process import YEAR

ROUNDED = 9  # decimals of a planned inventory: a limit is not passed by rounding


class DayFlow(NamedTuple):
    """A day between the two valuation dates.

    - `price`: forward price on the first date; `spot`: the spot price of the flow, by default
      `price`.
    - `planned`, `taken`: the planned and the actual net volume into the store.
    - `planned_cash`: the cash flow of the plan at the forward price; `forward_cash`, `cash`: the
      cash flow of the actual flow, at the forward price and at the spot price. All are net of
      costs, discounted to the second date.
    """

    date: str
    price: float
    spot: float
    planned: float
    taken: float
    planned_cash: float
    forward_cash: float
    cash: float


class PassedDays(NamedTuple):
    """The days between the two dates; `planned_inventory`: the planned inventory after them."""

    flows: tuple[DayFlow, ...]
    planned_inventory: float

    @property
    def planned_cash(self) -> float:
        return sum(flow.planned_cash for flow in self.flows)

    @property
    def forward_cash(self) -> float:
        return sum(flow.forward_cash for flow in self.flows)

    @property
    def cash(self) -> float:
        return sum(flow.cash for flow in self.flows)


class TakenFlow(NamedTuple):
    """An actual flow: net volume into the store, and its price."""

    volume: float
    price: float


def read_flows(file: Path) -> dict[datetime.date, TakenFlow]:
    """The flows of a CSV file with columns date,volume,price.

    **Raises:** `CaseError` if a date or a number is wrong, with its line.
    """
    reference = FileReference(TableContext(file, "flows", []), "flows", file.name)
    rows = read_rows(reference, ("date", "volume", "price"), ())
    numbers = [TakenFlow(row.number("volume"), row.number("price")) for row in rows]
    return dict(zip(rising_dates(rows), numbers, strict=True))


def passed_days(
    case: StorageCase,
    problem: Problem,
    policy: StoragePolicy,
    count: int,
    inventory: float,
    elapsed: int,
    flows: Mapping[datetime.date, TakenFlow] | None = None,
) -> PassedDays:
    """The first `count` days of a case, after which `inventory` is in store.

    The plan consists of the decisions of the policy at the forward prices. Without `flows` the
    difference between the inventory and the plan is spread evenly over the days; for a single day
    the actual flow is then exact.

    - `elapsed`: days from the valuation date of the case to the second one.
    - `flows`: the actual flows, one for each of these days.

    **Raises:** `CaseError` if a day has no flow, or the flows do not lead to the inventory.
    """
    rule = DatedRule(case, problem, policy, spot_filter(problem))
    level = np.full(1, float(problem.schedule.constants.inventory))
    prices, planned, levels = case.market.forward_curve.used(), [], [float(level[0])]
    state = rule.initial_factors(1)
    for t in range(count):
        result = decided(rule, t, problem, t, level, state, prices[t : t + 1])
        planned.append(float(result.injection[0] - result.withdrawal[0]))
        level, state = result.inventory, result.factors
        levels.append(float(level[0]))
    planned_inventory = round(levels[-1], ROUNDED) + 0.0
    if not count:
        return PassedDays((), planned_inventory)
    more = (inventory - levels[-1]) / count
    if abs(more) <= 1e-9 * max(abs(inventory), abs(levels[0]), 1.0):
        more = 0.0  # as planned, to rounding
    if flows is None:
        flows = {day: TakenFlow(planned[t] + more, float(prices[t]))
                 for t, day in enumerate(case.days[:count])}  # fmt: skip
    cash = _Cash(case, problem, elapsed)
    rows, taken_level = [], levels[0]
    for t in range(count):
        keep = 1 - float(problem.schedule.steps.inventory_loss[t])
        day, forward = case.days[t], float(prices[t])
        if day not in flows:
            message = "this day lies between the two valuation dates, and needs a line in the file"
            raise CaseError("--flows", "", day.isoformat(), message)
        taken, spot = flows[day]
        money = (
            cash.of(t, levels[t], planned[t], forward),
            cash.of(t, taken_level, taken, forward),
            cash.of(t, taken_level, taken, spot),
        )
        rows.append(DayFlow(day.isoformat(), forward, spot, planned[t], taken, *money))
        taken_level = taken_level * keep + taken
    if abs(taken_level - inventory) > 1e-6 * max(abs(inventory), abs(levels[0]), 1.0):
        message = (
            f"these flows lead to {taken_level:,.6g} in store, but the second run has "
            f"{inventory:,.6g}"
        )
        raise CaseError("--flows", "volume", None, message)
    return PassedDays(tuple(rows), planned_inventory)


class _Cash:
    """The money of the flow of a day, discounted to a later date."""

    def __init__(self, case: StorageCase, problem: Problem, elapsed: int):
        self.steps = problem.schedule.steps
        contract, market = case.contract, case.market

        def discount(days: np.ndarray) -> np.ndarray:
            since = np.asarray(days, np.float64)
            rates = np.interp(np.maximum(since, 0), market.zero_rate_day, market.zero_rate.used())
            return np.exp(-rates * np.maximum(since - elapsed, 0) / YEAR)

        self.gas = discount(market.gas_day)
        self.flow = discount(case.day)
        self.into = discount(contract.injection_cost_day)
        self.out = discount(contract.withdrawal_cost_day)

    def of(self, t: int, inventory: float, net: float, price: float) -> float:
        steps, injection, withdrawal = self.steps, max(net, 0.0), max(-net, 0.0)
        sold = withdrawal * (1 - steps.withdrawal_fuel[t])
        sold -= injection * (1 + steps.injection_fuel[t])
        money = price * self.gas[t] * sold
        money -= injection * steps.injection_cost[t] * self.into[t]
        money -= withdrawal * steps.withdrawal_cost[t] * self.out[t]
        return float(money - inventory * steps.inventory_cost[t] * self.flow[t])
