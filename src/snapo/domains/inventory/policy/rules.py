"""The classical rules of an item: policies with one to three numbers, and the best numbers of each
policy.

The myopic rule for lost sales places the order that minimises the cost of the period in which it
arrives: Morton (1971); Zipkin, Operations Research 56 (2008), section 4. For demand in whole units,
the probabilities of every stock in that period follow from the stock and the orders on their way;
the order is the smallest q with P(demand <= stock + q) >= p / (p + h).
"""

from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Actions, Product
from snapo.problem.inputs import Frozen
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT
from snapo.study.study import Setup

from ..item.estimates import economic_lot, mean_demand, usual_deviation
from ..setup import case_of
from .order_up_to import HEAD, within
from .search import cost_on_other_paths, search


class Myopic(Policy):
    """Tables of the rule, for stocks 0 … n - 1 and orders 0 … m - 1.

    - `moves` [n, n]: probabilities of the remaining stock, for each stock.
    - `met` [n, m]: P(demand <= remaining stock + q).
    - `ratio`: p / (p + h); `mean`: the mean of demand, relative to which stocks and orders are
      observed.
    """

    moves: Frozen
    met: Frozen
    ratio: float
    mean: float
    lead_time: int
    action: Actions

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        unit, moves, met = observation[1], self.moves.array, self.met.array
        n = moves.shape[0]
        amounts = jnp.round(observation[HEAD:] * unit + self.mean)
        probabilities = (jnp.arange(n) == jnp.minimum(amounts[0], n - 1)).astype(observation.dtype)
        for i in range(self.lead_time):
            probabilities = probabilities @ moves.astype(observation.dtype)
            if i + 1 < self.lead_time:
                probabilities = _moved(probabilities, amounts[1 + i])
        reached = probabilities @ met.astype(observation.dtype)
        order = jnp.sum(reached < self.ratio).astype(observation.dtype)
        return within(self.action, order, smooth)


def myopic(
    probabilities: Float[np.ndarray, " demands"],
    mean: float,
    holding: float,
    shortage: float,
    lead_time: int,
    action: Actions,
) -> Myopic:
    """The rule if demand is 0, 1, … with these probabilities."""
    n = 2 * len(probabilities)
    padded = np.zeros(n)
    padded[: len(probabilities)] = probabilities
    stocks = np.arange(n)
    back = np.subtract.outer(stocks, stocks)  # [stock, left]: the demand between them
    moves = np.where(back >= 0, padded[np.maximum(back, 0)], 0.0)
    moves[:, 0] += 1 - moves.sum(1)
    upto = np.cumsum(padded)
    met = upto[np.minimum(np.add.outer(stocks, np.arange(len(probabilities))), n - 1)]
    tables = (Frozen(jnp.asarray(item, jnp.float32)) for item in (moves, met))
    return Myopic(*tables, shortage / (shortage + holding), mean, lead_time, action)  # pyright: ignore


def _moved(probabilities: Array, by: Array) -> Array:
    """Probabilities of a stock after an amount is added, capped at the end of the grid."""
    n = probabilities.shape[0]
    positions = jnp.minimum(jnp.arange(n) + by.astype(jnp.int32), n - 1)
    return jnp.zeros_like(probabilities).at[positions].add(probabilities)


ENDLESS = 1e6  # units of demand: a level or a cap that never binds
RULES = {
    "base stock": ("above",),
    "capped base stock": ("above", "cap"),
    "constant order": ("cap",),
    "(s, S)": ("above", "reorder"),
}


class Classical(Policy):
    """The rule orders up to a level, at most a cap, and only if the position is below a reorder
    point.

    Level and reorder point are relative to the simulator's level of the period, so that
    they move with a season.

    - `above`: the level S minus the simulator's level; `cap`: the maximum order; `reorder`: an
      order is placed if the inventory position is below s = level + reorder.

    With an infinite cap and reorder point it is a base-stock rule; with a cap it is a
    capped base-stock rule (Xin, 2021), with an infinite level and a cap a constant order, and with
    a reorder point an (s, S) rule.
    """

    above: Float[Array, ""]
    cap: Float[Array, ""]
    reorder: Float[Array, ""]
    action: Actions

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        gap = observation[0] * observation[1]
        order = smooth.positive_part(gap + self.above, observation[1])
        is_placed = smooth.indicator(gap + self.reorder, observation[1])
        size = smooth.minimum(order, self.cap, observation[1])
        if not isinstance(self.action, Product):
            return within(self.action, is_placed * size, smooth)
        return jnp.concatenate(
            [jnp.stack([1 - is_placed, is_placed]), within(self.action["size"], size, smooth)]
        )


def item_rules(setup: Setup) -> Iterator[tuple[str, Classical, dict[str, float]]]:
    """(name, rule, its numbers as a planner writes them) for every classical rule with its best
    numbers."""
    base_stock: dict[str, float] = {}
    for name in RULES:
        if name == "(s, S)" and not case_of(setup).item.fixed:
            continue  # the same as base stock
        numbers = best_numbers(setup, name, base_stock)
        base_stock |= numbers if name == "base stock" else {}
        yield name, classical(setup, name, numbers), _for_planner(setup, numbers)


def classical(setup: Setup, name: str, numbers: dict[str, float]) -> Classical:
    """One of the rules with its parameters; parameters that a rule does not have are set so that
    they have no effect."""
    endless = ENDLESS * max(1.0, mean_demand(case_of(setup)))
    values = {key: numbers.get(key, endless) for key in ("above", "cap", "reorder")}
    arrays = {key: jnp.asarray(value, jnp.float32) for key, value in values.items()}
    return Classical(**arrays, action=setup.problem.action)


def best_numbers(setup: Setup, name: str, base_stock: dict[str, float]) -> dict[str, float]:
    """The best numbers of a rule, from a search on paths other than those of the value.

    - `base_stock`: the numbers of the base-stock rule, from which others may start.
    """
    case, keys, cost_of = case_of(setup), RULES[name], cost_on_other_paths(setup)
    mean, lot, deviation = mean_demand(case), economic_lot(case), usual_deviation(case)
    first = {"above": base_stock.get("above", lot), "cap": 1.5 * mean, "reorder": 0.0}
    if name == "constant order":
        first["cap"] = 0.9 * mean
    elif name == "(s, S)":
        first["above"] = max(lot, base_stock.get("above", 0.0))

    def cost(point: Sequence[float]) -> float:
        if "cap" in keys and point[-1] <= 0:
            return np.inf
        return cost_of(classical(setup, name, dict(zip(keys, point))))

    width = 1.0 if case.item.integer else deviation / 64
    start = [first[key] for key in keys]
    return dict(zip(keys, search(cost, start, max(width, deviation), width)))


def _for_planner(setup: Setup, numbers: dict[str, float]) -> dict[str, float]:
    """Level S, reorder point s, cap."""
    level = float(setup.problem.schedule.steps["level"][case_of(setup).warm_up])
    names = {"above": ("level", level), "reorder": ("reorder point", level), "cap": ("cap", 0.0)}
    return {label: base + numbers[key] for key, (label, base) in names.items() if key in numbers}


def myopic_of(setup: Setup) -> Policy | None:
    """The myopic rule. None if orders have a fixed cost, demand has a season, or lost demand is not
    in whole units. If demand waits, it is the base-stock rule at the newsvendor's level."""
    case = case_of(setup)
    item, demand = case.item, case.demand
    if item.fixed or case.seasonal:
        return None
    if not item.lost:
        return classical(setup, "base stock", {"above": 0.0})
    if not (demand.integral() and item.integer):
        return None
    probabilities = demand.probabilities(demand.values())
    costs = item.cost("holding"), item.cost("shortage")
    return myopic(probabilities, mean_demand(case), *costs, item.lead_time, setup.problem.action)
