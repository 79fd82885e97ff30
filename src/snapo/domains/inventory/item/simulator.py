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

Where an order has a cost of its own, training draws at random whether there is one, with the
probability that the policy gives, and multiplies costs by the likelihood of what was drawn
(`Choice.draw`). Placing a part of an order in place of that would be another problem: its best rule
is as sharp as it can be, and derivatives through a sharp threshold explode. (Trained so, rules
came to cost 1 to 18 % more than the best one, and the first rule was kept.)
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Actions, Box, Choice, Integers, Product
from snapo.problem.inputs import Input
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..demand.base import MEAN, as_input
from .estimates import memory, safety_factor, usual_cost
from .records import InventoryCase

CORNER = 8.0  # of a corner in units of the standard deviation of demand, times the temperature
MINIMUM = 1e-3  # of an arrival
OUTPUTS = ("result", "holding", "shortage", "purchase", "ordering")
AVERAGES = ("demand", "sold", "stock", "short", "orders", "ordered", "cycles", "cycles_met")


class InventorySimulator(Simulator):
    """One path of an item; the inputs are those of `inputs_of(case)`.

    State: "stock" (below zero: demand that waits), "coming" [L - 1], the next arrival first,
    "missed" (1 if demand was unmet since the last arrival; of the value alone), and with a cost of
    an order the "likelihood" of what training has drawn: 1, with a derivative.

    Outputs: "result", minus all costs, and its parts "holding", "shortage", "purchase",
    "ordering"; and averages of a period that counts: "demand", "sold" (met from stock at once),
    "stock" at the end, "short" (1 in a period with unmet demand), "orders", "ordered"; and of the
    value alone "cycles", which end with an arrival, and "cycles_met", without unmet demand.
    """

    case: InventoryCase = eqx.field(static=True)
    fully_observed = True

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Demand, and what decides whether an order is placed in training."""
        return 2 if self.case.item.fixed else 1

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.case.horizon

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        item = self.case.item
        size = Integers(0, item.maximum) if item.integer else Box(0.0, item.maximum)
        return Product(order=Choice(2), size=size) if item.fixed else size

    def prepare(self, inputs: Any) -> Schedule:
        case, item = self.case, self.case.item
        ahead = np.add.outer(np.arange(self.horizon), np.arange(item.lead_time + 1))
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
        return jnp.round(usual) if self.case.item.integer else usual

    def _coming(self, inputs, mean):
        if "start_coming" in inputs:
            return jnp.asarray(inputs["start_coming"])
        usual = mean[1 : max(self.case.item.lead_time, 1)]
        return jnp.round(usual) if self.case.item.integer else usual

    def initial(self, constants, noise):
        state = {"stock": constants["stock"], "missed": jnp.zeros(())}
        if self.case.item.fixed:
            state["likelihood"] = jnp.ones(())
        return state | ({"coming": constants["coming"]} if self.case.item.lead_time > 1 else {})

    def observe(self, constants, now, state):
        """[gap to the base-stock level, usual deviation, stock, coming …, season …]; all but the
        second in units of the second, the standard deviation of demand."""
        unit = constants["usual"]
        stock, coming = state["stock"], state.get("coming", jnp.zeros(0))
        gap = (now["level"] - stock - jnp.sum(coming)) / unit
        lead = self.case.item.lead_time
        observed = [
            jnp.stack([gap, unit, (stock - now["mean"][0]) / unit]),
            (coming - now["mean"][1 : max(lead, 1)]) / unit,
        ]
        if self.case.seasonal:
            observed.append((now["mean"] - constants["typical"]) / unit)
        return jnp.concatenate(observed)

    def step(self, constants, now, state, action, noise, smooth):
        item, corner = self.case.item, CORNER * constants["usual"]
        action, likelihood = self._drawn(state, action, noise, smooth)
        placed, order = _order(self.action, action, item.fixed, smooth)
        # In training orders follow a curve of the stock; a derivative by whole demand is right on
        # lines that are straight between whole numbers alone.
        spread = not isinstance(smooth, Exact)
        demand = self.case.demand.draw(now["demand"], noise[0], spread)
        stock = state["stock"] + (order if item.lead_time == 0 else 0.0)
        # Corners are differentiated upwards in stock: see `demand.counts`.
        left = smooth.positive_part(stock - demand, corner)
        short = left - (stock - demand)
        sold = smooth.positive_part(stock, corner) - left
        parts = {
            "holding": constants["holding"] * left,
            "shortage": constants["shortage"] * short,
            "purchase": constants["purchase"] * order,
            "ordering": constants["order"] * placed,
        }
        costs = {name: now["weight"] * part for name, part in parts.items()}
        unmet = smooth.indicator(short - (0.5 if self.case.demand.integral() else 1e-3), corner)
        missed, cycles = _cycle(state, order, unmet, item.lead_time, smooth)
        averages = dict(zip(AVERAGES, (demand, sold, left, unmet, placed, order, *cycles)))
        outputs = {"result": -sum(costs.values()), **costs}
        outputs |= {name: now["counted"] * average for name, average in averages.items()}
        if item.fixed:
            outputs = _weighted(outputs, likelihood, now["weight"] * usual_cost(self.case))
        after = left if item.lost else stock - demand
        moved = _next(state, after, order, item.lead_time) | {"missed": missed}
        return moved | ({"likelihood": likelihood} if item.fixed else {}), outputs

    def _drawn(self, state, action, noise, smooth):
        """(action, likelihood): in training with whether to order drawn, if that has a cost."""
        if not self.case.item.fixed:
            return action, 1.0
        if isinstance(smooth, Exact):
            return action, state["likelihood"]
        assert isinstance(self.action, Product)
        parts = self.action.parts(action)
        order = self.action["order"]
        assert isinstance(order, Choice)
        drawn, likelihood = order.draw(parts["order"], noise[1])
        # What was drawn long ago has no effect on this period, only noise.
        selected = 1 - 1 / memory(self.case)
        likelihood = likelihood * (1 + selected * (state["likelihood"] - 1))
        return jnp.concatenate([drawn, parts["size"]]), likelihood

    def in_mean(self):
        """Parameters of whole demand, and its season."""
        case = self.case
        if not case.demand.integral():
            return ()
        season = [case.season.name] if case.seasonal else []
        return (*(item.name for item in case.demand.inputs()), *season)

    def state_scale(self, constants):
        unit = constants["usual"]
        scale = {"stock": unit, "missed": jnp.ones(())}
        if self.case.item.fixed:
            scale["likelihood"] = jnp.ones(())
        if self.case.item.lead_time > 1:
            scale["coming"] = jnp.full(self.case.item.lead_time - 1, unit)
        return scale


def _order(action_set: Actions, action, fixed: bool, smooth):
    """(whether an order is placed, the amount ordered)."""
    if not fixed:
        return smooth.indicator(action[0] - 1e-3, 1.0), action[0]
    assert isinstance(action_set, Product)
    parts = action_set.parts(action)
    placed = parts["order"][1]
    return placed, placed * parts["size"][0]


def _weighted(outputs, likelihood, usual):
    """The outputs, with the derivative of the likelihood of what has led to them; of the result
    only as far as it is not `usual`, for the less is multiplied, the less noise there is."""
    innovation = outputs["result"] + usual
    weighted = {name: likelihood * output for name, output in outputs.items()}
    return weighted | {"result": outputs["result"] + (likelihood - 1) * innovation}


def _cycle(state, order, unmet, lead_time: int, smooth):
    """(whether the cycle that goes on has missed demand, (cycles that end, those without unmet
    demand)): of the value alone; training has no use for them."""
    nothing = jnp.zeros_like(unmet)
    if not isinstance(smooth, Exact):
        return state["missed"], (nothing, nothing)
    arrived = state["coming"][0] if lead_time > 1 else order
    endpoints = (arrived > MINIMUM).astype(unmet.dtype)
    if lead_time == 0:  # it ends before the demand of this period
        return jnp.maximum((1 - endpoints) * state["missed"], unmet), (
            endpoints,
            endpoints * (1 - state["missed"]),
        )
    missed = jnp.maximum(state["missed"], unmet)
    return (1 - endpoints) * missed, (endpoints, endpoints * (1 - missed))


def _next(state, after, order, lead_time: int):
    if lead_time == 0:
        return {"stock": after}
    if lead_time == 1:
        return {"stock": after + order}
    coming = state["coming"]
    moved = jnp.concatenate([coming[1:], order[None]])
    return {"stock": after + coming[0], "coming": moved}


def inputs_of(case: InventoryCase) -> dict[str, Input]:
    """Every number of the case that has a sensitivity."""
    results = [
        *case.item.inputs(),
        *case.demand.inputs(),
        *([case.season] if case.seasonal else []),
    ]
    return {x.name: as_input(x) for x in results}
