"""One item in one place: orders arrive after a lead time; demand is met from stock, is lost, or
waits.

A period t, with a lead time of L periods:

1. An order q(t) is placed, based on the stock x(t) and the L - 1 orders that are on their way (q(t
- L + 1) … q(t - 1); the order of L periods ago has just arrived and is part of x(t)).
2. Demand d(t) is met from stock: left = max(x - d, 0), short = max(d - x, 0).
3. The period costs holding left + shortage short + purchase q + (order cost if q > 0).
4. The order of L - 1 periods ago arrives: x(t + 1) = left + q(t - L + 1); where unmet demand
   waits, x(t + 1) = x - d + q(t - L + 1).

With L = 0 the order of this period is on hand before its demand. Timing and notation follow Zipkin,
Old and new methods for lost-sales inventory systems, Operations Research 56 (2008).

If an order has a fixed cost, training draws at random whether an order is placed, with the
probability given by the policy, and multiplies costs by the likelihood ratio of the draw
(`Choice.draw`). An order that is placed in part would be a different problem: its best rule has a
threshold that is as sharp as possible, and derivatives through a sharp threshold explode. (Rules
trained in that way cost 1 to 18 % more than the best rule, so the initial rule was used.)
"""

from dataclasses import replace
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snapo.problem.actions import Actions, Box, Choice, Integers, Product
from snapo.problem.form import formed
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..demand.base import MEAN, Demand
from .estimates import base_stock, memory, safety_factor, season_ahead, usual_cost
from .records import InventoryCase

CORNER = 8.0  # of a corner in units of the standard deviation of demand, times the temperature
MINIMUM = 1e-3  # of an arrival
OUTPUTS = ("result", "holding", "shortage", "purchase", "ordering")
AVERAGES = ("demand", "sold", "stock", "short", "orders", "ordered", "cycles", "cycles_met")


class InventorySimulator(Simulator):
    """One path of an item; the inputs are those of `InventoryCase.inputs`.

    It contains no case: items of the same form differ only in arrays and inputs.

    **Arguments:** `lost`, `lead_time`, `integer`, `fixed` as in an `Item`; `seasonal`: whether
    periods differ; `demand`: the demand of the case, after `formed`; `weights`, `counted` [T] as
    in the case; and the estimates `safety_factor`, `usual_cost` and `memory`.

    State: "stock" (below zero: demand that waits), "coming" [L - 1], the next arrival first,
    "missed" (1 if demand was unmet since the last arrival; exact simulation only), and with a fixed
    cost the "likelihood" ratio of the draws of training, whose value is 1 but whose derivative is
    not 0.

    Outputs: "result", minus all costs, and its parts "holding", "shortage", "purchase",
    "ordering"; and averages over the periods that count: "demand", "sold" (met from stock at
    once), "stock" at the end, "short" (1 in a period with unmet demand), "orders", "ordered". Only
    exact simulation has "cycles", which end with an arrival, and "cycles_met", the cycles without
    unmet demand.
    """

    lost: bool = eqx.field(static=True)
    lead_time: int = eqx.field(static=True)
    integer: bool = eqx.field(static=True)
    fixed: bool = eqx.field(static=True)
    seasonal: bool = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    action: Actions = eqx.field(static=True)
    demand: Demand
    weights: Float[np.ndarray, " T"]
    counted: Float[np.ndarray, " T"]
    safety_factor: Float[np.ndarray, ""]
    usual_cost: Float[np.ndarray, ""]
    memory: Float[np.ndarray, ""]
    fully_observed = True

    @classmethod
    def of(cls, case: InventoryCase) -> Self:
        """The simulator of a case."""
        item = case.item
        size = Integers(0, item.maximum) if item.integer else Box(0.0, item.maximum)
        return cls(  # pyright: ignore[reportCallIssue]
            lost=item.lost,
            lead_time=item.lead_time,
            integer=item.integer,
            fixed=item.fixed,
            seasonal=case.seasonal,
            horizon=case.horizon,
            action=Product(order=Choice(2), size=size) if item.fixed else size,
            demand=formed(case.demand),
            weights=case.weights,
            counted=case.counted,
            safety_factor=np.asarray(safety_factor(case)),
            usual_cost=np.asarray(usual_cost(case)),
            memory=np.asarray(memory(case)),
        )

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The normals of a period: for demand and, with a fixed cost, for the draw that decides in
        training whether an order is placed."""
        return 2 if self.fixed else 1

    def prepare(self, inputs: Any) -> Schedule:
        factors = jnp.asarray(inputs.get("season", np.ones(1)))
        season = season_ahead(factors, self.horizon, self.lead_time)
        mean, deviation = inputs[MEAN] * season, self.demand.deviation(inputs, season)
        usual = deviation[: len(factors), 0].mean()
        level = base_stock(mean, deviation, self.safety_factor)
        steps = {
            "demand": self.demand.prepare(inputs, season[:, 0]),
            "weight": jnp.asarray(self.weights),
            "counted": jnp.asarray(self.counted),
            "level": level,
            "mean": mean,
        }
        costs = {name: inputs[f"{name}_cost"] for name in ("holding", "shortage", "purchase")}
        costs["order"] = inputs["order_cost"] if self.fixed else jnp.zeros(())
        constants = {
            **costs,
            "usual": usual,
            "typical": mean[: len(factors), 0].mean(),
            "stock": self._stock(inputs, level[0], mean[0]),
            "coming": self._coming(inputs, mean[0]),
        }
        if self.fixed:
            # What was drawn long ago has no effect on a period, only noise.
            constants |= {"usual_cost": self.usual_cost, "remembered": 1 - 1 / self.memory}
        return Schedule(constants, steps)

    def on_paths(self):
        return jax.tree.map(lambda leaf: None, self)

    def on_step(self):
        return replace(self, horizon=None)

    def _stock(self, inputs, level, mean):
        """The initial stock of the case, or the level minus the orders on their way."""
        if "start_stock" in inputs:
            return jnp.asarray(inputs["start_stock"])[0]
        usual = jnp.maximum(level - jnp.sum(mean[1:]), 0.0)
        return jnp.round(usual) if self.integer else usual

    def _coming(self, inputs, mean):
        if "start_coming" in inputs:
            return jnp.asarray(inputs["start_coming"])
        usual = mean[1 : max(self.lead_time, 1)]
        return jnp.round(usual) if self.integer else usual

    def initial(self, constants, noise):
        state = {"stock": constants["stock"], "missed": jnp.zeros(())}
        if self.fixed:
            state["likelihood"] = jnp.ones(())
        return state | ({"coming": constants["coming"]} if self.lead_time > 1 else {})

    def observe(self, constants, now, state):
        """[gap to the base-stock level, usual deviation, stock, coming …, season …]; all but the
        second are divided by the second, which is the standard deviation of demand."""
        unit = constants["usual"]
        stock, coming = state["stock"], state.get("coming", jnp.zeros(0))
        gap = (now["level"] - stock - jnp.sum(coming)) / unit
        lead = self.lead_time
        observed = [
            jnp.stack([gap, unit, (stock - now["mean"][0]) / unit]),
            (coming - now["mean"][1 : max(lead, 1)]) / unit,
        ]
        if self.seasonal:
            observed.append((now["mean"] - constants["typical"]) / unit)
        return jnp.concatenate(observed)

    def step(self, constants, now, state, action, noise, smooth):
        corner = CORNER * constants["usual"]
        action, likelihood = self._drawn(constants, state, action, noise, smooth)
        placed, order = _order(self.action, action, self.fixed, smooth)
        # In training orders follow a curve of the stock; a derivative with respect to whole demand
        # is right on lines that are straight between whole numbers only.
        spread = not isinstance(smooth, Exact)
        demand = self.demand.draw(now["demand"], noise[0], spread)
        stock = state["stock"] + (order if self.lead_time == 0 else 0.0)
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
        unmet = smooth.indicator(short - 1e-3, corner)
        missed, cycles = _cycle(state, order, unmet, self.lead_time, smooth)
        averages = dict(zip(AVERAGES, (demand, sold, left, unmet, placed, order, *cycles)))
        outputs = {"result": -sum(costs.values()), **costs}
        outputs |= {name: now["counted"] * average for name, average in averages.items()}
        if self.fixed:
            outputs = _weighted(outputs, likelihood, now["weight"] * constants["usual_cost"])
        after = left if self.lost else stock - demand
        moved = _next(state, after, order, self.lead_time) | {"missed": missed}
        return moved | ({"likelihood": likelihood} if self.fixed else {}), outputs

    def _drawn(self, constants, state, action, noise, smooth):
        """(action, likelihood). If an order has a cost, training draws at random whether to
        order."""
        if not self.fixed:
            return action, 1.0
        if isinstance(smooth, Exact):
            return action, state["likelihood"]
        assert isinstance(self.action, Product)
        parts = self.action.parts(action)
        order = self.action["order"]
        assert isinstance(order, Choice)
        drawn, likelihood = order.draw(parts["order"], noise[1])
        likelihood = likelihood * (1 + constants["remembered"] * (state["likelihood"] - 1))
        return jnp.concatenate([drawn, parts["size"]]), likelihood

    def in_mean(self):
        """The parameters of demand in whole units, and its season."""
        if not self.demand.integral():
            return ()
        return (*self.demand.names(), *(["season"] if self.seasonal else []))

    def state_scale(self, constants):
        unit = constants["usual"]
        scale = {"stock": unit, "missed": jnp.ones(())}
        if self.fixed:
            scale["likelihood"] = jnp.ones(())
        if self.lead_time > 1:
            scale["coming"] = jnp.full(self.lead_time - 1, unit)
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
    """The outputs times the likelihood ratio of the draws before them; of the result, only the
    deviation from minus the `usual` cost is multiplied, since a smaller factor adds less noise."""
    innovation = outputs["result"] + usual
    weighted = {name: likelihood * output for name, output in outputs.items()}
    return weighted | {"result": outputs["result"] + (likelihood - 1) * innovation}


def _cycle(state, order, unmet, lead_time: int, smooth):
    """(whether the current cycle has missed demand, (cycles that end, those without unmet demand)).
    Only the exact value needs them, not training."""
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
