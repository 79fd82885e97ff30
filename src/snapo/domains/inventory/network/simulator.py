"""Places that supply one another: each orders from one other place, or from outside.

A period:

1. Every place orders, knowing all stocks and goods on their way. A supplier with less than all
   that is asked of it shares it in proportion, and sends nothing later: what is missing is asked
   for again.
2. Goods arrive: with a lead time of 0 those just sent, else those sent that many periods ago.
3. Stores of a pool that acts before demand balance their stocks.
4. Demand is met from stock; in a pool that acts after it, what is left goes where stock was short.
   Demand that is still unmet is lost, or waits (stock is then below zero).
5. Holding is paid on stock and on goods on their way from a place, shortage on unmet demand; where
   an order has a cost of its own, it is paid by order placed, also where less is sent, or nothing.

A place has `lead_time + 1` periods of demand to cover before its next order can arrive, and one
that it supplies as many more: the line of Clark and Scarf (1960) with lead times one longer.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Actions, Box, Integers, Product
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from .fixed import LikelihoodWeights, choices, placed
from .inputs import demands, selling
from .levels import levels, season, start
from .records import NetworkCase
from .transshipment import in_pieces, move_after, move_before

CORNER = 8.0  # of a corner in deviations of demand, times the temperature
OUTPUTS = ("result", "holding", "shortage", "ordering", "transshipment")
TOTALS = {name: name for name in ("demand", "sold", "stock", "orders")} | {"received": "moved"}
AVERAGES = (*TOTALS.values(), "short", "level", "ordered")

Amounts = dict[str, tuple[Any, tuple[int, ...]]]  # [n] by place, and the places that have any


class NetworkSimulator(Simulator):
    """One path of a network; the inputs are those of `network_inputs(case)`.

    State: "stock" [n]; where a lead time is above zero "coming" [n, longest lead time], the
    next arrival first; with costs of an order the "likelihood" [m] of what training has drawn: 1,
    with a derivative. Action [n]: the amount that each place asks for; with pools of stores more
    parts, [m] each: "held", the amount that a store holds back after demand; "band" and "shift",
    how far from balance its stock may be before demand, and how much higher its balance is; and
    "order_NAME", whether a place orders, where an order has a cost of its own.

    Outputs: "result", minus all costs; "holding", "shortage"; averages of a period that counts:
    "demand", "sold" (met at once), "stock" and "short" (1 where any place falls short), and
    "stock_NAME", "sold_NAME", "demand_NAME" by place, "level_NAME" up to which it orders. With
    pools also the cost "transshipment", and on average "moved", "sent_NAME", "received_NAME". With
    costs of an order "ordering", and on average "orders", "orders_NAME", "ordered_NAME", a number
    of goods; "level_NAME" is then that of a period with an order, 0 in another.
    """

    case: NetworkCase = eqx.field(static=True)

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.case.horizon

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Demands, and what decides in training whether a place orders."""
        return len(self.case.sellers) + len(self.case.fixed)

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        case, amounts = self.case, Integers if self.case.integer else Box
        sets: dict[str, Actions] = {"order": amounts(0.0, np.inf, len(case.sites))}
        if held := len(case.moving(False)):
            sets["held"] = amounts(0.0, np.inf, held)
        if balanced := len(case.moving(True)):
            sets |= {
                "band": amounts(0.0, np.inf, balanced),
                "shift": Box(-np.inf, np.inf, balanced),
            }
        sets |= choices(case)
        return Product(**sets) if len(sets) > 1 else sets["order"]

    @property
    def longest(self) -> int:
        """The longest lead time."""
        return max(position.lead_time for position in self.case.sites)

    def prepare(self, inputs: Any) -> Schedule:
        """What differs by period stands in the steps where there is a season, else once in the
        constants: `step` looks for it in both."""
        case = self.case
        periods = self.horizon if case.seasonal else 1
        result = levels(case, inputs, periods)
        item = {
            "level": result.level,
            "ahead": result.ahead,
            "mean": result.ahead[:, :, 0],
            "demand": [
                demand.prepare(local, season(local, periods))
                for demand, local in demands(case, inputs)
            ],
        }
        stock, coming = start(case)
        nothing = jnp.zeros(len(case.sites))
        constants = {
            "holding": inputs["holding_cost"],
            "shortage": nothing.at[jnp.asarray(case.sellers)].set(inputs["shortage_cost"]),
            "unit": result.unit,
            "typical": result.typical,
            "corner": CORNER * result.unit,
            "stock": stock,
            "coming": coming,
        }
        if case.transshipment is not None:
            constants["transshipment"] = inputs[case.transshipment.name]
        if case.ordering is not None:
            constants["order"] = nothing.at[jnp.asarray(case.fixed)].set(inputs["order_cost"])
        steps = {"weight": jnp.asarray(case.weights), "counted": jnp.asarray(case.counted)}
        if not case.seasonal:
            return Schedule(constants | jax.tree.map(lambda x: x[0], item), steps)
        return Schedule(constants, steps | item)

    def initial(self, constants, noise):
        state = {"stock": constants["stock"]}
        if self.longest:
            state["coming"] = constants["coming"]
        if self.case.fixed:
            state["likelihood"] = jnp.ones(len(self.case.fixed))
        return state

    def observe(self, constants, now, state):
        """[gap of each echelon to its level, unit of each place, stock …, coming …, season …]; all
        but the units in units, the standard deviation of the demand that a place serves."""
        case, here = self.case, {**constants, **now}
        unit, stock, ahead = here["unit"], state["stock"], here["ahead"]
        coming = state.get("coming", jnp.zeros((len(case.sites), 0)))
        gap = (here["level"] - self._echelon(state)) / unit
        observed = [gap, unit, (stock - here["stock"]) / unit]
        for i, position in enumerate(case.sites):
            observed.append(
                (coming[i, : position.lead_time] - ahead[i, : position.lead_time]) / unit[i]
            )
        for i, (position, _) in zip(case.sellers, selling(case)):
            if position.season is not None:
                observed.append(
                    (ahead[i, : case.lead_time_from_outside(i)] - here["typical"][i]) / unit[i]
                )
        return jnp.concatenate(observed)

    def _echelon(self, state):
        """[n] goods at a place, on their way there and further down, less demand that waits."""
        stock = state["stock"]
        local = stock + state["coming"].sum(1) if self.longest else stock
        return jnp.asarray(self.case.serves, stock.dtype) @ local

    def step(self, constants, now, state, action, noise, smooth):
        case, here = self.case, {**constants, **now}
        parts = {"order": action}
        if isinstance(self.action, Product):
            parts = self.action.parts(action)
        drawn, requested = self._placed(parts, state, noise, smooth)
        stock, sent = self._sent(here, state["stock"], requested, smooth)
        after, arrived = self._moved(state, sent)
        stock, moves = stock + arrived, []
        if "band" in parts:
            moves.append(move_before(case, here, stock, parts["band"], parts["shift"], smooth))
            stock = moves[-1].stock
        request = self._asked(here, noise, smooth, stock.dtype)
        stock = stock - request
        if "held" in parts:
            moves.append(move_after(case, here, stock, parts["held"], smooth))
            stock = moves[-1].stock
        left = smooth.positive_part(stock, here["corner"])
        short = left - stock
        # Goods that waited were met first.
        sold = smooth.positive_part(request - short, here["corner"])
        everywhere = tuple(range(len(case.sites)))
        level = self._echelon(state) + requested
        amounts: Amounts = {
            "stock": (left, everywhere),
            "demand": (request, case.sellers),
            "sold": (sold, case.sellers),
            "level": (level if drawn is None else drawn.orders * level, everywhere),
        }
        if drawn is not None:
            amounts |= {"orders": (drawn.orders, case.fixed), "ordered": (requested, case.fixed)}
            after["likelihood"] = drawn.likelihood
        weights = LikelihoodWeights(case, None if drawn is None else drawn.likelihood)
        outputs = self._costs(here, after, left, short, moves, drawn, weights)
        outputs |= self._means(here, amounts, short, moves, weights, smooth)
        after["stock"] = left if case.lost else stock
        return after, outputs

    def _placed(self, parts, state, noise, smooth):
        """(which places order, None where no order has a cost; amounts asked for [n])."""
        if not self.case.fixed:
            return None, parts["order"]
        assert isinstance(self.action, Product)
        local = noise[len(self.case.sellers) :]
        drawn = placed(self.case, self.action, parts, state["likelihood"], local, smooth)
        return drawn, drawn.orders * parts["order"]

    def _asked(self, here, noise, smooth, dtype):
        """[n] demand of customers."""
        request = jnp.zeros(len(self.case.sites), dtype)
        # In training orders are no whole numbers, so that a derivative by whole demand, which is
        # right on lines that are straight between them, would be wrong.
        spread = not isinstance(smooth, Exact)
        for k, (i, (_, demand)) in enumerate(zip(self.case.sellers, selling(self.case))):
            request = request.at[i].set(demand.draw(here["demand"][k], noise[k], spread))
        return request

    def _costs(self, here, after, left, short, moves, drawn, weights):
        """Costs by part, and the result."""
        coming = after["coming"].sum(1) if self.longest else jnp.zeros_like(left)
        away = jnp.asarray(self.case.supplies, left.dtype) @ coming
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
        """Averages of a period, of the network and by place."""
        case, means = self.case, {}
        if moves:
            members = tuple(sorted({*case.moving(False), *case.moving(True)}))
            amounts = amounts | {
                "sent": (jnp.stack([entry.sent for entry in moves]).sum(0), members),
                "received": (jnp.stack([value.received for value in moves]).sum(0), members),
            }
        for path, (item, positions) in amounts.items():
            mine = weights.of(item)
            means |= {f"{path}_{case.sites[i].name}": mine[i] for i in positions}
            if path in TOTALS:
                means[TOTALS[path]] = mine[jnp.asarray(positions)].sum()
        fell = smooth.indicator(jnp.max(short) - 1e-3, here["corner"][0])
        means["short"] = weights.of_all(fell)
        return {name: here["counted"] * each for name, each in means.items()}

    def _sent(self, constants, stock, requested, smooth):
        """(stocks after sending [n], amounts sent to each place [n])."""
        supplies = jnp.asarray(self.case.supplies, stock.dtype)
        total = supplies @ requested
        held = smooth.positive_part(stock, constants["corner"])
        # In this order, as stock is differentiated upwards where it is just what was asked for.
        values = smooth.minimum(held, total, constants["corner"])
        some = total > 0
        share = jnp.where(some, values, 1.0) / jnp.where(some, total, 1.0)
        outside = jnp.asarray([float(p.supplier is None) for p in self.case.sites], stock.dtype)
        sent = requested * outside
        for amounts, mine in zip(requested * share[:, None], supplies):
            sent = sent + in_pieces(self.case, mine * amounts, smooth)
        return stock - supplies @ sent, sent

    def _moved(self, state, sent):
        """(the goods on their way, arrivals [n])."""
        if not self.longest:
            return {}, sent
        lead_time = np.array([position.lead_time for position in self.case.sites])
        slots = jnp.asarray(np.arange(self.longest + 1) == lead_time[:, None], sent.dtype)
        full = jnp.concatenate([state["coming"], jnp.zeros_like(sent)[:, None]], 1)
        full = full + slots * sent[:, None]
        return {"coming": full[:, 1:]}, full[:, 0]

    def in_mean(self):
        """Parameters of whole demand, and its season."""
        return tuple(
            f"{position.name}.{item.name}"
            for position, demand in selling(self.case)
            if demand.integral()
            for item in (
                *demand.inputs(),
                *([position.season] if position.season is not None else []),
            )
        )

    def state_scale(self, constants):
        unit = constants["unit"]
        scale = {"stock": unit}
        if self.longest:
            scale["coming"] = unit[:, None] * jnp.ones((1, self.longest))
        if self.case.fixed:
            scale["likelihood"] = jnp.ones(len(self.case.fixed))
        return scale
