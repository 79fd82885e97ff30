"""The days between two valuation dates: the flows planned on the first one, those taken, and
their cash."""

from typing import NamedTuple

import numpy as np

from snapo.problem.problem import Problem

from ..contract.records import StorageCase
from ..history.rule import DatedRule, decided, spot_filter
from ..policy.network import StoragePolicy
from ..prices.process import YEAR


class DayFlow(NamedTuple):
    """A day between the two valuation dates.

    - `price`: forward price on the first date; `planned`, `taken`: net volume into the store;
      `planned_cash`, `cash`: what they earn, less their costs, discounted to the second date.
    """

    date: str
    price: float
    planned: float
    taken: float
    planned_cash: float
    cash: float


class PassedDays(NamedTuple):
    """The days between; `planned_inventory`: in store after them as planned."""

    flows: tuple[DayFlow, ...]
    planned_inventory: float

    @property
    def planned_cash(self) -> float:
        return sum(flow.planned_cash for flow in self.flows)

    @property
    def cash(self) -> float:
        return sum(flow.cash for flow in self.flows)


def passed_days(
    case: StorageCase,
    problem: Problem,
    policy: StoragePolicy,
    count: int,
    inventory: float,
    elapsed: int,
) -> PassedDays:
    """The first `count` days of a case, after which `inventory` is in store.

    Planned are the decisions of the policy at the forward prices. The difference of the inventory
    to the plan is spread evenly over the days; of one day the flow taken is exact.

    - `elapsed`: days from the valuation date of the case to the second one.
    """
    rule = DatedRule(case, problem, policy, spot_filter(problem))
    level = np.full(1, float(problem.schedule.constants.inventory))
    prices, state, planned, levels = case.market.forward_curve.used(), None, [], [float(level[0])]
    state = rule.initial_factors(1)
    for t in range(count):
        result = decided(rule, t, problem, t, level, state, prices[t : t + 1])
        planned.append(float(result.injection[0] - result.withdrawal[0]))
        level, state = result.inventory, result.factors
        levels.append(float(level[0]))
    if not count:
        return PassedDays((), levels[0])
    more = (inventory - levels[-1]) / count
    if abs(more) <= 1e-9 * max(abs(inventory), abs(levels[0]), 1.0):
        more = 0.0  # as planned, to rounding
    cash = _Cash(case, problem, elapsed)
    rows, taken_level = [], levels[0]
    for t in range(count):
        keep = 1 - float(problem.schedule.steps.inventory_loss[t])
        taken = planned[t] + more
        money = cash.of(t, levels[t], planned[t]), cash.of(t, taken_level, taken)
        rows.append(DayFlow(case.days[t].isoformat(), float(prices[t]), planned[t], taken, *money))
        taken_level = taken_level * keep + taken
    return PassedDays(tuple(rows), levels[-1])


class _Cash:
    """The money of a day's flow at the forward price, discounted to a later date."""

    def __init__(self, case: StorageCase, problem: Problem, elapsed: int):
        self.steps, self.prices = problem.schedule.steps, case.market.forward_curve.used()
        contract, market = case.contract, case.market

        def discount(days: np.ndarray) -> np.ndarray:
            since = np.asarray(days, np.float64)
            rates = np.interp(np.maximum(since, 0), market.zero_rate_day, market.zero_rate.used())
            return np.exp(-rates * np.maximum(since - elapsed, 0) / YEAR)

        self.gas = discount(market.gas_day)
        self.flow = discount(case.day)
        self.into = discount(contract.injection_cost_day)
        self.out = discount(contract.withdrawal_cost_day)

    def of(self, t: int, inventory: float, net: float) -> float:
        steps, injection, withdrawal = self.steps, max(net, 0.0), max(-net, 0.0)
        sold = withdrawal * (1 - steps.withdrawal_fuel[t])
        sold -= injection * (1 + steps.injection_fuel[t])
        money = self.prices[t] * self.gas[t] * sold
        money -= injection * steps.injection_cost[t] * self.into[t]
        money -= withdrawal * steps.withdrawal_cost[t] * self.out[t]
        return float(money - inventory * steps.inventory_cost[t] * self.flow[t])
