"""The classical rules of an item: policies with one to three numbers, and the best of these."""

from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Actions, Product
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT
from snapo.study.study import Setup

from ..item.estimates import economic_lot, mean_demand, usual_deviation
from ..setup import case_of
from .myopic import myopic
from .order_up_to import within
from .search import cost_on_other_paths, search

ENDLESS = 1e6  # units of demand: a level or a cap that never binds
RULES = {
    "base stock": ("above",),
    "capped base stock": ("above", "cap"),
    "constant order": ("cap",),
    "(s, S)": ("above", "reorder"),
}


class Classical(Policy):
    """Order up to a level, at most a cap, and only from a reorder point down.

    Level and reorder point are given relative to the simulator's level of the period, so that
    they move with a season.

    - `above`: the level S is higher by this; `cap`: the maximum order; `reorder`: an order is
      placed if the inventory position is below s = level + reorder.

    With an infinite cap and reorder point it is a base-stock rule; with a cap a capped base-stock
    rule (Xin, 2021); with an infinite level and a cap a constant order; with a reorder point an
    (s, S) rule.
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
    """(name, rule, its numbers in a planner's terms), each with its best numbers."""
    base_stock: dict[str, float] = {}
    for name in RULES:
        if name == "(s, S)" and not case_of(setup).item.fixed:
            continue  # the same as base stock
        numbers = best_numbers(setup, name, base_stock)
        base_stock |= numbers if name == "base stock" else {}
        yield name, classical(setup, name, numbers), _for_planner(setup, numbers)


def classical(setup: Setup, name: str, numbers: dict[str, float]) -> Classical:
    """One of the rules with its parameters; those that it does not have never bind."""
    endless = ENDLESS * max(1.0, mean_demand(case_of(setup)))
    values = {key: numbers.get(key, endless) for key in ("above", "cap", "reorder")}
    arrays = {key: jnp.asarray(value, jnp.float32) for key, value in values.items()}
    return Classical(**arrays, action=setup.problem.action)


def best_numbers(setup: Setup, name: str, base_stock: dict[str, float]) -> dict[str, float]:
    """The best numbers of a rule, searched on other paths than those of the value.

    - `base_stock`: those of the base-stock rule, where others may start.
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
    """The myopic rule, where it has no simpler form: lost sales of whole demand, no season.

    Where demand waits it is the base stock at the newsvendor's level.
    """
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
