"""One item in one place: orders arrive after a lead time, demand is met from stock, lost or waits.

A period t, with a lead time of L periods:

1. An order q(t) is placed, knowing the stock x(t) and the L - 1 orders that are on their way
   (q(t - L + 1) … q(t - 1); that of L periods ago has just arrived and is part of x(t)).
2. Demand d(t) is met from stock: left = max(x - d, 0), short = max(d - x, 0).
3. The period costs holding left + shortage short + purchase q + (order cost if q > 0).
4. The order of L - 1 periods ago arrives: x(t + 1) = left + q(t - L + 1); where unmet demand
   waits, x(t + 1) = x - d + q(t - L + 1).

With L = 0 the order of this period is on hand before its demand. Timing and names are those of
Zipkin, Old and new methods for lost-sales inventory systems, Operations Research 56 (2008).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import stats

from snapo.problem.actions import Actions, Box, Choice, Product, Whole
from snapo.problem.inputs import Input
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..demand.base import MEAN
from .records import InventoryCase

CORNER = 8.0  # of a corner in units of the standard deviation of demand, times the temperature
# In training an order is placed in part, and a small part must not be cheap: it would be best to
# order a little of it every period. Its cost is K (1 - (1 - part)^8); 0 and K where part is 0 or 1.
SHARE = 8
OUTPUTS = ("result", "holding", "shortage", "purchase", "ordering")
AVERAGES = ("demand", "sold", "stock", "short", "orders", "ordered")


class InventorySimulator(Simulator):
    """One path of an item; the inputs are those of `inputs_of(case)`.

    State: "stock" (below zero: demand that waits), and "coming" [L - 1], the next arrival first.

    Outputs: "result", minus all costs, and its parts "holding", "shortage", "purchase",
    "ordering"; and averages of a period that counts: "demand", "sold" (met from stock at once),
    "stock" at the end, "short" (1 in a period with unmet demand), "orders", "ordered".
    """

    case: InventoryCase = eqx.field(static=True)
    noise_size: int = eqx.field(static=True, default=1)

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.case.horizon

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        item = self.case.item
        size = Whole(1, 0, item.most) if item.whole else Box(1, 0.0, item.most)
        return Product(order=Choice(2), size=size) if item.fixed else size

    def prepare(self, inputs: Any) -> Schedule:
        case, item = self.case, self.case.item
        ahead = np.add.outer(np.arange(self.horizon), np.arange(item.lead + 1))
        season = jnp.asarray(inputs.get("season", np.ones(1)))[ahead % len(case.season.values)]
        mean, deviation = inputs[MEAN] * season, case.demand.deviation(inputs, season)
        usual = deviation[: len(case.season.values), 0].mean()
        safety = jnp.sqrt(jnp.sum(deviation**2, 1))
        level = jnp.sum(mean, 1) + safety_factor(case) * safety
        steps = {
            "demand": case.demand.prepare(inputs, season[:, 0]),
            "weight": jnp.asarray(case.weights),
            "counted": jnp.asarray(case.counted),
            "level": level,
            "mean": mean,
        }
        costs = {name: inputs[f"{name}_cost"] for name in ("holding", "shortage", "purchase")}
        costs["order"] = inputs["order_cost"] if item.fixed else jnp.zeros(())
        constants = {
            **costs,
            "usual": usual,
            "typical": mean[: len(case.season.values), 0].mean(),
            "stock": self._stock(inputs, level[0], mean[0]),
            "coming": self._coming(inputs, mean[0]),
        }
        return Schedule(constants, steps)

    def _stock(self, inputs, level, mean):
        """Given, or the level less the orders on their way."""
        if "start_stock" in inputs:
            return jnp.asarray(inputs["start_stock"])[0]
        usual = jnp.maximum(level - jnp.sum(mean[1:]), 0.0)
        return jnp.round(usual) if self.case.item.whole else usual

    def _coming(self, inputs, mean):
        if "start_coming" in inputs:
            return jnp.asarray(inputs["start_coming"])
        usual = mean[1 : max(self.case.item.lead, 1)]
        return jnp.round(usual) if self.case.item.whole else usual

    def initial(self, constants, noise):
        state = {"stock": constants["stock"]}
        return state | ({"coming": constants["coming"]} if self.case.item.lead > 1 else {})

    def observe(self, constants, now, state):
        """[gap to the base-stock level, usual deviation, stock, coming …, season …]; all but the
        second in units of the second, the standard deviation of demand."""
        unit = constants["usual"]
        stock, coming = state["stock"], state.get("coming", jnp.zeros(0))
        gap = (now["level"] - stock - jnp.sum(coming)) / unit
        lead = self.case.item.lead
        seen = [
            jnp.stack([gap, unit, (stock - now["mean"][0]) / unit]),
            (coming - now["mean"][1 : max(lead, 1)]) / unit,
        ]
        if self.case.seasonal:
            seen.append((now["mean"] - constants["typical"]) / unit)
        return jnp.concatenate(seen)

    def step(self, constants, now, state, action, noise, smooth):
        item, corner = self.case.item, CORNER * constants["usual"]
        placed, order = _order(self.action, action, item.fixed, smooth)
        # Whether to order is trained where the stock meets a threshold: it must pass through it.
        spread = item.fixed and not isinstance(smooth, Exact)
        demand = self.case.demand.draw(now["demand"], noise[0], spread)
        stock = state["stock"] + (order if item.lead == 0 else 0.0)
        # Corners are differentiated upwards in stock: see `demand.counts`.
        left = smooth.positive_part(stock - demand, corner)
        short = left - (stock - demand)
        sold = smooth.positive_part(stock, corner) - left
        parts = {
            "holding": constants["holding"] * left,
            "shortage": constants["shortage"] * short,
            "purchase": constants["purchase"] * order,
            "ordering": constants["order"] * (1 - (1 - placed) ** SHARE),
        }
        costs = {name: now["weight"] * part for name, part in parts.items()}
        unmet = smooth.indicator(short - (0.5 if self.case.demand.integral() else 1e-3), corner)
        averages = dict(zip(AVERAGES, (demand, sold, left, unmet, placed, order)))
        outputs = {"result": -sum(costs.values()), **costs}
        outputs |= {name: now["counted"] * each for name, each in averages.items()}
        after = left if item.lost else stock - demand
        return _next(state, after, order, item.lead), outputs

    def state_scale(self, constants):
        unit = constants["usual"]
        scale = {"stock": unit}
        if self.case.item.lead > 1:
            scale["coming"] = jnp.full(self.case.item.lead - 1, unit)
        return scale


def _order(action_set: Actions, action, fixed: bool, smooth):
    """(whether an order is placed, the amount ordered)."""
    if not fixed:
        return smooth.indicator(action[0] - 1e-3, 1.0), action[0]
    assert isinstance(action_set, Product)
    parts = action_set.parts(action)
    placed = parts["order"][1]
    return placed, placed * parts["size"][0]


def _next(state, after, order, lead: int):
    if lead == 0:
        return {"stock": after}
    if lead == 1:
        return {"stock": after + order}
    coming = state["coming"]
    moved = jnp.concatenate([coming[1:], order[None]])
    return {"stock": after + coming[0], "coming": moved}


def safety_factor(case: InventoryCase) -> float:
    """Standard deviations of the demand of L + 1 periods above its mean, of the first base stock.

    The newsvendor's quantile p / (p + h); of lost sales p / (p + (L + 1) h), as if demand waited
    at a shortage cost of p / (L + 1), which costs less than losing it does (Janakiraman, Seshadri
    and Shanthikumar, Operations Research 55, 2007). It is where training starts.
    """
    item = case.item
    holding = item.cost("holding") * (item.lead + 1 if item.lost else 1)
    ratio = item.cost("shortage") / (item.cost("shortage") + holding)
    return float(np.clip(stats.norm.ppf(ratio), -1.0, 4.0))


def inputs_of(case: InventoryCase) -> dict[str, Input]:
    """Every number of the case that has a sensitivity."""
    found = [*case.item.given(), *case.demand.given(), *([case.season] if case.seasonal else [])]
    return {each.name: _plain(each) for each in found}


def _plain(given) -> Input:
    """One number as one number, not as a list of one."""
    made = given.input()
    if given.labels != ("",):
        return made
    return eqx.tree_at(lambda each: each.value, made, made.value.reshape(()))
