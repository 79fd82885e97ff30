"""Places that supply one another: each orders from one other place, or from outside.

A period:

1. Every place orders, knowing all stocks and goods on their way. A supplier with less than all
   that is asked of it shares it in proportion, and sends nothing later: what is missing is asked
   for again.
2. Goods arrive: with a lead time of 0 those just sent, else those sent that many periods ago.
3. Demand is met from stock; without stock it is lost, or waits (stock is then below zero).
4. Holding is paid on stock and on goods on their way from a place, shortage on unmet demand.

A place has `lead_time + 1` periods of demand to cover before its next order can arrive, and one
that it supplies as many more: the line of Clark and Scarf (1960) with lead times one longer.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import stats

from snapo.problem.actions import Actions, Box
from snapo.problem.inputs import Input
from snapo.problem.simulator import Schedule, Simulator

from .records import NetworkCase

CORNER = 8.0  # of a corner in deviations of demand, times the temperature
OUTPUTS = ("result", "holding", "shortage")
AVERAGES = ("demand", "sold", "stock", "short")


class NetworkSimulator(Simulator):
    """One path of a network; the inputs are those of `network_inputs(case)`.

    State: "stock" [n], and where a lead time is above zero "coming" [n, longest lead time], the
    next arrival first. Action [n]: the amount that each place asks for.

    Outputs: "result", minus all costs; "holding", "shortage"; averages of a period that counts:
    "demand", "sold" (from stock at once), "stock" and "short" (1 where any place falls short),
    and "stock_NAME", "sold_NAME", "demand_NAME" by place.
    """

    case: NetworkCase = eqx.field(static=True)

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.case.horizon

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.case.sellers)

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Box(len(self.case.places), 0.0)

    @property
    def longest(self) -> int:
        """The longest lead time."""
        return max(place.lead for place in self.case.places)

    def prepare(self, inputs: Any) -> Schedule:
        case, one = self.case, jnp.ones(1)
        parameters = [_own(inputs, case.places[i].name) for i in case.sellers]
        demands = [case.places[i].demand for i in case.sellers]
        means = jnp.stack([each["demand_mean"] for each in parameters])
        spreads = [d.deviation(p, one)[0] for d, p in zip(demands, parameters) if d is not None]
        reach = jnp.asarray(case.serves[:, case.sellers])
        mean = reach @ means
        unit = jnp.sqrt(reach @ jnp.stack(spreads) ** 2)
        cover = jnp.asarray(case.cover, float)
        level = cover * mean + jnp.asarray(safety_factors(case)) * unit * jnp.sqrt(cover)
        # A place starts with its echelon's level less those of the places that it supplies.
        direct = jnp.asarray(case.supplies)
        leads = jnp.asarray([float(place.lead) for place in case.places])
        constants = {
            "holding": inputs["holding_cost"],
            "shortage": inputs["shortage_cost"],
            "level": level,
            "unit": unit,
            "mean": mean,
            "stock": jnp.maximum(level - direct @ level - leads * mean, 0.0),
            "demand": [
                {name: leaf[0] for name, leaf in d.prepare(p, one).items()}
                for d, p in zip(demands, parameters)
                if d is not None
            ],
        }
        steps = {"weight": jnp.asarray(case.weights), "counted": jnp.asarray(case.counted)}
        return Schedule(constants, steps)

    def initial(self, constants, noise):
        state = {"stock": constants["stock"]}
        if self.longest:
            slots = np.arange(self.longest) < np.array([[p.lead] for p in self.case.places])
            state["coming"] = constants["mean"][:, None] * slots
        return state

    def observe(self, constants, now, state):
        """[gap of each echelon to its level, unit of each place, stock …, coming …]; all but the
        units in units, the standard deviation of the demand that a place serves."""
        unit, stock = constants["unit"], state["stock"]
        coming = state.get("coming", jnp.zeros((len(self.case.places), 0)))
        echelon = jnp.asarray(self.case.serves, stock.dtype) @ (stock + coming.sum(1))
        gap = (constants["level"] - echelon) / unit
        seen = [gap, unit, (stock - constants["stock"]) / unit]
        for i, place in enumerate(self.case.places):
            seen.append((coming[i, : place.lead] - constants["mean"][i]) / unit[i])
        return jnp.concatenate(seen)

    def step(self, constants, now, state, action, noise, smooth):
        case, n = self.case, len(self.case.places)
        corner = CORNER * constants["unit"]
        stock, sent = self._sent(constants, state["stock"], action, smooth)
        after, arrived = self._moved(state, sent)
        stock = stock + arrived
        demand = [
            case.places[i].demand.draw(constants["demand"][k], noise[k], False)  # pyright: ignore
            for k, i in enumerate(case.sellers)
        ]
        asked = jnp.zeros(n, stock.dtype)
        for i, each in zip(case.sellers, demand):
            asked = asked.at[i].set(each)
        left = smooth.positive_part(stock - asked, corner)
        short = (left - (stock - asked))[jnp.asarray(case.sellers)]
        sold = smooth.positive_part(stock, corner) - left
        coming = after["coming"].sum(1) if self.longest else jnp.zeros(n, stock.dtype)
        away = jnp.asarray(case.supplies, stock.dtype) @ coming
        parts = {
            "holding": constants["holding"] @ (left + away),
            "shortage": constants["shortage"] @ short,
        }
        costs = {name: now["weight"] * part for name, part in parts.items()}
        unmet = smooth.indicator(jnp.max(short) - 1e-3, corner[0])
        means = {"demand": asked.sum(), "sold": sold[jnp.asarray(case.sellers)].sum(),
                 "stock": left.sum(), "short": unmet}  # fmt: skip
        for i, place in enumerate(case.places):
            means[f"stock_{place.name}"] = left[i]
            if place.demand is not None:
                means |= {f"sold_{place.name}": sold[i], f"demand_{place.name}": asked[i]}
        outputs = {"result": -sum(costs.values()), **costs}
        outputs |= {name: now["counted"] * each for name, each in means.items()}
        after["stock"] = left if case.lost else stock - asked
        return after, outputs

    def _sent(self, constants, stock, wanted, smooth):
        """(stocks after sending [n], amounts sent to each place [n])."""
        supplies = jnp.asarray(self.case.supplies, stock.dtype)
        total = supplies @ wanted
        held = smooth.positive_part(stock, CORNER * constants["unit"])
        given = smooth.minimum(total, held, CORNER * constants["unit"])
        some = total > 0
        share = jnp.where(some, given, 1.0) / jnp.where(some, total, 1.0)
        outside = jnp.asarray([float(p.supplier is None) for p in self.case.places], stock.dtype)
        sent = wanted * (outside + share @ supplies)
        return stock - supplies @ sent, sent

    def _moved(self, state, sent):
        """(the goods on their way, arrivals [n])."""
        if not self.longest:
            return {}, sent
        leads = np.array([place.lead for place in self.case.places])
        slots = jnp.asarray(np.arange(self.longest + 1) == leads[:, None], sent.dtype)
        full = jnp.concatenate([state["coming"], jnp.zeros_like(sent)[:, None]], 1)
        full = full + slots * sent[:, None]
        return {"coming": full[:, 1:]}, full[:, 0]

    def state_scale(self, constants):
        unit = constants["unit"]
        scale = {"stock": unit}
        if self.longest:
            scale["coming"] = unit[:, None] * jnp.ones((1, self.longest))
        return scale


def safety_factors(case: NetworkCase) -> np.ndarray:
    """[n] deviations of the first echelon levels above the mean: the middle of two newsvendors'.

    Shang and Song, Management Science 49 (2003): with echelon holding costs h and u their sum
    upstream of a place, z of (p + u) / (p + all h) and of (p + u) / (p + h + u).
    """
    holding, shortage = case.holding.values, case.shortage.values
    found = []
    for i, place in enumerate(case.places):
        reached = [k for k, j in enumerate(case.sellers) if case.serves[i, j]]
        p = float(np.mean(shortage[reached]))
        local = float(np.mean([holding[case.sellers[k]] for k in reached]))
        up = float(holding[place.supplier]) if place.supplier is not None else 0.0
        ratios = (p + up) / (p + local), (p + up) / (p + max(holding[i], up))
        found.append(np.mean([stats.norm.ppf(min(each, 0.9999)) for each in ratios]))
    return np.clip(found, -1.0, 4.0)


def network_inputs(case: NetworkCase) -> dict[str, Input]:
    """Every number of the case that has a sensitivity."""
    found = {each.name: each.input() for each in (case.holding, case.shortage)}
    for i in case.sellers:
        place = case.places[i]
        assert place.demand is not None
        for each in place.demand.given():
            made = each.input()
            made = eqx.tree_at(lambda x: x.value, made, made.value.reshape(()))
            found[f"{place.name}.{each.name}"] = made
    return found


def _own(inputs: Any, name: str) -> dict[str, Any]:
    """The parameters of the demand of one place."""
    start = f"{name}."
    return {key[len(start) :]: inputs[key] for key in inputs if key.startswith(start)}
