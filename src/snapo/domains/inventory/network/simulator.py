"""Places that supply one another: each orders from one other place, or from outside.

A period:

1. Every place orders, based on all stocks and goods on their way. A supplier with less than the sum
   of the orders shares its stock in proportion, and sends nothing later: places order the rest
   again.
2. Goods arrive: those sent one lead time ago or, with a lead time of 0, those just sent.
3. Stores of a pool that acts before demand balance their stocks.
4. Demand is met from stock; in a pool that acts after it, remaining stock is sent to places that
   ran out. Demand that is still unmet is lost, or waits (stock is then below zero).
5. Holding costs are paid for stock and for goods on their way from a place, shortage costs for
   unmet demand, and a fixed cost for every order, even if less is sent, or nothing.

A place has to cover `lead_time + 1` periods of demand before its next order can arrive, and a place
that it supplies covers them too. A line is the model of Clark and Scarf (1960) with lead times + 1.
"""

from dataclasses import replace
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snapo.problem.actions import Actions, Box, Integers, Product
from snapo.problem.form import formed
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..demand.base import MEAN, Demand
from .estimates import memory, safety_factors, usual_costs
from .fixed import LikelihoodWeights, choices, placed
from .records import NetworkCase, SupplyNetwork
from .transshipment import in_pieces, move_after, move_before

CORNER = 8.0  # of a corner in deviations of demand, times the temperature
OUTPUTS = ("result", "holding", "shortage", "ordering", "transshipment")
TOTALS = {name: name for name in ("demand", "sold", "stock", "orders")} | {"received": "moved"}
AVERAGES = (*TOTALS.values(), "short", "level", "ordered")

Amounts = dict[str, tuple[Any, tuple[int, ...]]]  # [n] by place, and the places that have any


class Levels(NamedTuple):
    """The levels of n places in T periods, in units of demand.

    - `ahead` [T, n, R]: mean demand that a place serves in a period, and in the R - 1 periods after
      it; R covers the longest way from outside to a customer.
    - `level` [T, n]: first levels of the echelon: the mean demand of the periods that it covers,
      plus a safety stock.
    - `unit` [n]: the standard deviation of the demand that a place serves; `typical` [n]: the mean
      of this demand; both over the season.
    """

    ahead: jax.Array
    level: jax.Array
    unit: jax.Array
    typical: jax.Array


class NetworkSimulator(Simulator):
    """One path of a network; the inputs are those of `NetworkCase.inputs`.

    It contains no case: networks of the same form differ only in arrays and inputs.

    **Arguments:** `network`; `horizon`; `demands`: the demands of the case, after `formed`;
    `first`: the numbers of demand from which a path starts, which no input changes; `weights`,
    `counted` [T] as in the case; and the estimates `safety_factors` [n], `usual_costs` [n] and
    `memory` [m].

    State: "stock" [n]; if a lead time is above zero, "coming" [n, longest lead time], the next
    arrival first; with fixed costs "likelihood" [m], the ratios for the draws of training, whose
    value is 1 but whose derivative is not 0. Action [n]: the amount that each place orders; with
    pools of stores it has further parts of shape [m]: "held", the amount that a store holds back
    after demand; "band", the deviation from balance that is allowed before demand; and "shift", the
    shift of the balance. "order_NAME" is whether a place with a fixed cost orders.

    Outputs: "result", minus all costs; "holding", "shortage"; averages over the periods that count:
    "demand", "sold" (met at once), "stock" and "short" (1 if any place has a shortage); and for
    each place "stock_NAME", "sold_NAME", "demand_NAME", and its order-up-to level "level_NAME".
    Pools add the cost "transshipment", and the averages "moved", "sent_NAME", "received_NAME". If
    an order has a cost, this adds the cost "ordering", and the averages "orders", "orders_NAME" and
    "ordered_NAME", the amount ordered; "level_NAME" is then 0 in a period without an order.
    """

    network: SupplyNetwork = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    demands: tuple[Demand, ...]
    first: dict[str, np.ndarray]
    weights: Float[np.ndarray, " T"]
    counted: Float[np.ndarray, " T"]
    safety_factors: Float[np.ndarray, " n"]
    usual_costs: Float[np.ndarray, " n"]
    memory: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, case: NetworkCase) -> Self:
        """The simulator of a case."""
        return cls(  # pyright: ignore[reportCallIssue]
            network=case.network,
            horizon=case.horizon,
            demands=formed(case.demands),
            first={name: x.value for name, x in case.inputs().items() if name in case.of_demand},
            weights=case.weights,
            counted=case.counted,
            safety_factors=safety_factors(case),
            usual_costs=usual_costs(case),
            memory=memory(case),
        )

    def on_paths(self):
        return jax.tree.map(lambda leaf: None, self)

    def on_step(self):
        return replace(self, horizon=None)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Normals for demands, and for the draws that decide in training whether a place orders."""
        return len(self.network.sellers) + len(self.network.fixed)

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        network, amounts = self.network, Integers if self.network.integer else Box
        sets: dict[str, Actions] = {"order": amounts(0.0, np.inf, len(network.sites))}
        if held := len(network.moving(False)):
            sets["held"] = amounts(0.0, np.inf, held)
        if balanced := len(network.moving(True)):
            sets |= {
                "band": amounts(0.0, np.inf, balanced),
                "shift": Box(-np.inf, np.inf, balanced),
            }
        sets |= choices(network)
        return Product(**sets) if len(sets) > 1 else sets["order"]

    def prepare(self, inputs: Any) -> Schedule:
        """Numbers that may differ between periods are in the steps if there is a season, and
        otherwise in the constants; `step` reads both."""
        network = self.network
        periods = self.horizon if network.seasonal else 1
        result = self.levels(inputs, periods)
        item = {
            "level": result.level,
            "ahead": result.ahead,
            "mean": result.ahead[:, :, 0],
            "demand": [
                demand.prepare(local, _season(local, periods))
                for demand, local in self._demands(inputs)
            ],
        }
        stock, coming = self.start()
        nothing = jnp.zeros(len(network.sites))
        constants = {
            "holding": inputs["holding_cost"],
            "shortage": nothing.at[jnp.asarray(network.sellers)].set(inputs["shortage_cost"]),
            "unit": result.unit,
            "typical": result.typical,
            "corner": CORNER * result.unit,
            "stock": stock,
            "coming": coming,
        }
        if network.pools:
            constants["transshipment"] = inputs["transshipment_cost"]
        if network.fixed:
            constants["order"] = nothing.at[jnp.asarray(network.fixed)].set(inputs["order_cost"])
            constants["usual_costs"] = jnp.asarray(self.usual_costs)
            constants["remembered"] = 1 - 1 / jnp.asarray(self.memory)
        steps = {"weight": jnp.asarray(self.weights), "counted": jnp.asarray(self.counted)}
        if not network.seasonal:
            return Schedule(constants | jax.tree.map(lambda x: x[0], item), steps)
        return Schedule(constants, steps | item)

    def levels(self, inputs: Any, periods: int) -> Levels:
        """The levels of the first `periods` periods, which are all equal without a season."""
        network = self.network
        reach = jnp.asarray(network.serves[:, network.sellers])
        longest = int(max(network.lead_time_from_outside(i) for i in network.sellers))
        means, spreads, usual, typical = [], [], [], []
        for demand, local in self._demands(inputs):
            factors = _season(local, periods + longest)
            means.append(local[MEAN] * factors)
            spreads.append(demand.deviation(local, factors))
            once = local.get("season", jnp.ones(1))
            typical.append(local[MEAN] * once.mean())
            usual.append(demand.deviation(local, once).mean())
        item = np.add.outer(np.arange(periods), np.arange(longest))
        mean = (reach @ jnp.stack(means))[:, item]
        variance = (reach @ jnp.stack(spreads) ** 2)[:, item]
        covered = jnp.asarray(np.arange(longest) < network.cover[:, None], mean.dtype)[:, None]
        safety = jnp.sqrt(jnp.sum(variance * covered, 2))
        level = jnp.sum(mean * covered, 2) + jnp.asarray(self.safety_factors)[:, None] * safety
        unit = jnp.sqrt(reach @ jnp.stack(usual) ** 2)
        return Levels(jnp.swapaxes(mean, 0, 1), level.T, unit, reach @ jnp.stack(typical))

    def _demands(self, inputs: Any) -> list[tuple[Demand, dict[str, Any]]]:
        """(demand, its parameters, and the season if there is one) of every place that sells."""
        parameters = []
        for i in self.network.sellers:
            start = f"{self.network.sites[i].name}."
            parameters.append(
                {key.removeprefix(start): inputs[key] for key in inputs if key.startswith(start)}
            )
        return list(zip(self.demands, parameters))

    def start(self) -> tuple[jax.Array, jax.Array]:
        """Stock [n] and arrivals [n, longest lead time] at the start.

        A place starts with its echelon's level minus the levels of the places that it supplies.
        """
        network, result = self.network, self.levels(self.first, 1)
        level, lead_time = result.level[0], np.array([site.lead_time for site in network.sites])
        slots = np.arange(max(lead_time)) < lead_time[:, None]
        coming = result.ahead[0, :, : slots.shape[1]] * slots
        stock = level - jnp.asarray(network.supplies) @ level - coming.sum(1)
        stock = jnp.maximum(stock, 0.0)
        return (jnp.round(stock), jnp.round(coming)) if network.integer else (stock, coming)

    def initial(self, constants, noise):
        state = {"stock": constants["stock"]}
        if self.network.longest:
            state["coming"] = constants["coming"]
        if self.network.fixed:
            state["likelihood"] = jnp.ones(len(self.network.fixed))
        return state

    def observe(self, constants, now, state):
        """[gap of each echelon to its level, unit of each place, stock …, coming …, season …]; all
        but the units are divided by the unit, the standard deviation of the demand of a place."""
        network, here = self.network, {**constants, **now}
        unit, stock, ahead = here["unit"], state["stock"], here["ahead"]
        coming = state.get("coming", jnp.zeros((len(network.sites), 0)))
        gap = (here["level"] - self._echelon(state)) / unit
        observed = [gap, unit, (stock - here["stock"]) / unit]
        for i, site in enumerate(network.sites):
            periods = site.lead_time
            observed.append((coming[i, :periods] - ahead[i, :periods]) / unit[i])
        for i in network.sellers:
            if network.sites[i].seasonal:
                periods = network.lead_time_from_outside(i)
                observed.append((ahead[i, :periods] - here["typical"][i]) / unit[i])
        return jnp.concatenate(observed)

    def _echelon(self, state):
        """[n] goods at a place, on the way to it and further downstream, minus waiting demand."""
        stock = state["stock"]
        local = stock + state["coming"].sum(1) if self.network.longest else stock
        return jnp.asarray(self.network.serves, stock.dtype) @ local

    def step(self, constants, now, state, action, noise, smooth):
        network, here = self.network, {**constants, **now}
        parts = {"order": action}
        if isinstance(self.action, Product):
            parts = self.action.parts(action)
        drawn, requested = self._placed(here, parts, state, noise, smooth)
        stock, sent = self._sent(here, state["stock"], requested, smooth)
        after, arrived = self._moved(state, sent)
        stock, moves = stock + arrived, []
        if "band" in parts:
            moves.append(move_before(network, here, stock, parts["band"], parts["shift"], smooth))
            stock = moves[-1].stock
        request = self._asked(here, noise, smooth, stock.dtype)
        stock = stock - request
        if "held" in parts:
            moves.append(move_after(network, here, stock, parts["held"], smooth))
            stock = moves[-1].stock
        left = smooth.positive_part(stock, here["corner"])
        short = left - stock
        # Goods that waited were met first.
        sold = smooth.positive_part(request - short, here["corner"])
        everywhere = tuple(range(len(network.sites)))
        level = self._echelon(state) + requested
        amounts: Amounts = {
            "stock": (left, everywhere),
            "demand": (request, network.sellers),
            "sold": (sold, network.sellers),
            "level": (level if drawn is None else drawn.orders * level, everywhere),
        }
        if drawn is not None:
            amounts |= {
                "orders": (drawn.orders, network.fixed),
                "ordered": (requested, network.fixed),
            }
            after["likelihood"] = drawn.likelihood
        likelihood = None if drawn is None else drawn.likelihood
        weights = LikelihoodWeights(network, likelihood, here.get("usual_costs"))
        outputs = self._costs(here, after, left, short, moves, drawn, weights)
        outputs |= self._means(here, amounts, short, moves, weights, smooth)
        after["stock"] = left if network.lost else stock
        return after, outputs

    def _placed(self, here, parts, state, noise, smooth):
        """(the places that order, None if no order has a cost; the amounts ordered [n])."""
        if not self.network.fixed:
            return None, parts["order"]
        assert isinstance(self.action, Product)
        local = noise[len(self.network.sellers) :]
        likelihood, remembered = state["likelihood"], here["remembered"]
        drawn = placed(self.network, self.action, parts, likelihood, remembered, local, smooth)
        return drawn, drawn.orders * parts["order"]

    def _asked(self, here, noise, smooth, dtype):
        """[n] demand of customers."""
        request = jnp.zeros(len(self.network.sites), dtype)
        # In training orders are no whole numbers, so that a derivative with respect to whole
        # demand, which is right on lines that are straight between them, would be wrong.
        spread = not isinstance(smooth, Exact)
        for k, (i, demand) in enumerate(zip(self.network.sellers, self.demands)):
            request = request.at[i].set(demand.draw(here["demand"][k], noise[k], spread))
        return request

    def _costs(self, here, after, left, short, moves, drawn, weights):
        """The parts of the cost, and the result."""
        coming = after["coming"].sum(1) if self.network.longest else jnp.zeros_like(left)
        away = jnp.asarray(self.network.supplies, left.dtype) @ coming
        by_place = {
            "holding": here["holding"] * (left + away),
            "shortage": here["shortage"] * short,
        }
        if drawn is not None:
            by_place["ordering"] = here["order"] * drawn.orders
        costs = {name: jnp.sum(weights.of(item)) for name, item in by_place.items()}
        together = sum(by_place.values())
        result = jnp.sum(together) + weights.innovation(together)
        if moves:
            moved = jnp.stack([entry.cost for entry in moves]).sum()
            costs["transshipment"] = weights.of_all(moved)
            result = result + costs["transshipment"]
        outputs = {name: here["weight"] * cost for name, cost in costs.items()}
        return outputs | {"result": -here["weight"] * result}

    def _means(self, here, amounts: Amounts, short, moves, weights, smooth):
        """Averages per period, of the whole network and of every place."""
        network, means = self.network, {}
        if moves:
            members = tuple(sorted({*network.moving(False), *network.moving(True)}))
            amounts = amounts | {
                "sent": (jnp.stack([entry.sent for entry in moves]).sum(0), members),
                "received": (jnp.stack([value.received for value in moves]).sum(0), members),
            }
        for path, (item, sites) in amounts.items():
            mine = weights.of(item)
            means |= {f"{path}_{network.sites[i].name}": mine[i] for i in sites}
            if path in TOTALS:
                means[TOTALS[path]] = mine[jnp.asarray(sites)].sum()
        fell = smooth.indicator(jnp.max(short) - 1e-3, here["corner"][0])
        means["short"] = weights.of_all(fell)
        return {name: here["counted"] * each for name, each in means.items()}

    def _sent(self, constants, stock, requested, smooth):
        """(stocks after sending [n], amounts sent to each place [n])."""
        supplies = jnp.asarray(self.network.supplies, stock.dtype)
        total = supplies @ requested
        held = smooth.positive_part(stock, constants["corner"])
        # In this order, since the derivative with respect to stock is the one upwards at equality.
        values = smooth.minimum(held, total, constants["corner"])
        some = total > 0
        share = jnp.where(some, values, 1.0) / jnp.where(some, total, 1.0)
        outside = jnp.asarray([float(p.supplier is None) for p in self.network.sites], stock.dtype)
        sent = requested * outside
        for amounts, mine in zip(requested * share[:, None], supplies):
            sent = sent + in_pieces(self.network, mine * amounts, smooth)
        return stock - supplies @ sent, sent

    def _moved(self, state, sent):
        """(the goods on their way, arrivals [n])."""
        if not self.network.longest:
            return {}, sent
        lead_time = np.array([site.lead_time for site in self.network.sites])
        slots = jnp.asarray(np.arange(self.network.longest + 1) == lead_time[:, None], sent.dtype)
        full = jnp.concatenate([state["coming"], jnp.zeros_like(sent)[:, None]], 1)
        full = full + slots * sent[:, None]
        return {"coming": full[:, 1:]}, full[:, 0]

    def in_mean(self):
        """The parameters of demand in whole units, and its season."""
        sites = [self.network.sites[i] for i in self.network.sellers]
        return tuple(
            f"{site.name}.{name}"
            for site, demand in zip(sites, self.demands)
            if demand.integral()
            for name in (*demand.names(), *(["season"] if site.seasonal else []))
        )

    def state_scale(self, constants):
        unit = constants["unit"]
        scale = {"stock": unit}
        if self.network.longest:
            scale["coming"] = unit[:, None] * jnp.ones((1, self.network.longest))
        if self.network.fixed:
            scale["likelihood"] = jnp.ones(len(self.network.fixed))
        return scale


def _season(local: dict[str, Any], periods: int) -> jax.Array:
    """[T] the season's factors of a place's demand, from the inputs."""
    factors = jnp.asarray(local.get("season", jnp.ones(1)))
    return factors[np.arange(periods) % len(factors)]
