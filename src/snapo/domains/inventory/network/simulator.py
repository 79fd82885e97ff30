"""Places that supply one another: each orders from one other place, or from outside.

A period:

1. Every place orders, knowing all stocks and goods on their way. A supplier with less than all
   that is asked of it shares it in proportion, and sends nothing later: what is missing is asked
   for again.
2. Goods arrive: with a lead time of 0 those just sent, else those sent that many periods ago.
3. Stores of a pool that acts before demand balance their stocks.
4. Demand is met from stock; in a pool that acts after it, what is left goes where stock was short.
   Demand that is still unmet is lost, or waits (stock is then below zero).
5. Holding is paid on stock and on goods on their way from a place, shortage on unmet demand.

A place has `lead_time + 1` periods of demand to cover before its next order can arrive, and one
that it supplies as many more: the line of Clark and Scarf (1960) with lead times one longer.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import stats

from snapo.problem.actions import Actions, Box, Product, Whole
from snapo.problem.inputs import Input
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..demand.base import Demand
from .records import NetworkCase
from .transshipment import in_pieces, move_after, move_before

CORNER = 8.0  # of a corner in deviations of demand, times the temperature
OUTPUTS = ("result", "holding", "shortage", "transshipment")
AVERAGES = ("demand", "sold", "stock", "short", "moved", "level")


class NetworkSimulator(Simulator):
    """One path of a network; the inputs are those of `network_inputs(case)`.

    State: "stock" [n], and where a lead time is above zero "coming" [n, longest lead time], the
    next arrival first. Action [n]: the amount that each place asks for; with pools of stores more
    parts, [m] each: "held", the amount that a store holds back after demand; "band" and "shift",
    how far from balance its stock may be before demand, and how much higher its balance is.

    Outputs: "result", minus all costs; "holding", "shortage"; averages of a period that counts:
    "demand", "sold" (met at once), "stock" and "short" (1 where any place falls short), and
    "stock_NAME", "sold_NAME", "demand_NAME" by place, "level_NAME" up to which it orders. With
    pools also the cost "transshipment", and on average "moved", "sent_NAME", "received_NAME".
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
        case, amounts = self.case, Whole if self.case.whole else Box
        sets: dict[str, Actions] = {"order": amounts(len(case.places), 0.0)}
        if held := len(case.moving(False)):
            sets["held"] = amounts(held, 0.0)
        if balanced := len(case.moving(True)):
            sets |= {"band": amounts(balanced, 0.0), "shift": Box(balanced)}
        return Product(**sets) if len(sets) > 1 else sets["order"]

    @property
    def longest(self) -> int:
        """The longest lead time."""
        return max(place.lead for place in self.case.places)

    def prepare(self, inputs: Any) -> Schedule:
        case, one = self.case, jnp.ones(1)
        mean, unit, level = self._levels(inputs)
        demand = [
            {name: leaf[0] for name, leaf in demand.prepare(own, one).items()}
            for demand, own in self._demands(inputs)
        ]
        stock, coming = self._start()
        constants = {
            "holding": inputs["holding_cost"],
            "shortage": inputs["shortage_cost"],
            "level": level,
            "unit": unit,
            "corner": CORNER * unit,
            "mean": mean,
            "stock": stock,
            "coming": coming,
            "demand": demand,
        }
        if case.transshipment is not None:
            constants["transshipment"] = inputs[case.transshipment.name]
        steps = {"weight": jnp.asarray(case.weights), "counted": jnp.asarray(case.counted)}
        return Schedule(constants, steps)

    @property
    def _sold(self) -> list[Demand]:
        """The demand of every place that sells."""
        demands = [self.case.places[i].demand for i in self.case.sellers]
        return [each for each in demands if each is not None]

    def _demands(self, inputs: Any) -> list[tuple[Demand, dict[str, Any]]]:
        """(demand, its parameters) of every place that sells."""
        names = [self.case.places[i].name for i in self.case.sellers]
        return [(demand, _own(inputs, name)) for demand, name in zip(self._sold, names)]

    def _levels(self, inputs: Any):
        """[n] means and deviations of the demand that a place serves, and first echelon levels."""
        case, demands = self.case, self._demands(inputs)
        reach = jnp.asarray(case.serves[:, case.sellers])
        means = jnp.stack([jnp.asarray(own["demand_mean"]) for _, own in demands])
        spreads = [demand.deviation(own, jnp.ones(1))[0] for demand, own in demands]
        mean, unit = reach @ means, jnp.sqrt(reach @ jnp.stack(spreads) ** 2)
        cover = jnp.asarray(case.cover, float)
        safety = jnp.asarray(safety_factors(case)) * unit * jnp.sqrt(cover)
        return mean, unit, cover * mean + safety

    def _start(self):
        """Stock and arrivals of a period [n] at the start: a fact that moves with no input.

        A place starts with its echelon's level less those of the places that it supplies.
        """
        case = self.case
        own = {name: each.value for name, each in network_inputs(case).items()}
        mean, _, level = self._levels(own)
        leads = jnp.asarray([float(place.lead) for place in case.places])
        stock = jnp.maximum(level - jnp.asarray(case.supplies) @ level - leads * mean, 0.0)
        return (jnp.round(stock), jnp.round(mean)) if case.whole else (stock, mean)

    def initial(self, constants, noise):
        state = {"stock": constants["stock"]}
        if self.longest:
            slots = np.arange(self.longest) < np.array([[p.lead] for p in self.case.places])
            state["coming"] = constants["coming"][:, None] * slots
        return state

    def observe(self, constants, now, state):
        """[gap of each echelon to its level, unit of each place, stock …, coming …]; all but the
        units in units, the standard deviation of the demand that a place serves."""
        unit, stock = constants["unit"], state["stock"]
        coming = state.get("coming", jnp.zeros((len(self.case.places), 0)))
        gap = (constants["level"] - self._echelon(state)) / unit
        seen = [gap, unit, (stock - constants["stock"]) / unit]
        for i, place in enumerate(self.case.places):
            seen.append((coming[i, : place.lead] - constants["mean"][i]) / unit[i])
        return jnp.concatenate(seen)

    def _echelon(self, state):
        """[n] goods at a place, on their way there and further down, less demand that waits."""
        stock = state["stock"]
        own = stock + state["coming"].sum(1) if self.longest else stock
        return jnp.asarray(self.case.serves, stock.dtype) @ own

    def step(self, constants, now, state, action, noise, smooth):
        case, n, corner = self.case, len(self.case.places), constants["corner"]
        parts = {"order": action}
        if isinstance(self.action, Product):
            parts = self.action.parts(action)
        stock, sent = self._sent(constants, state["stock"], parts["order"], smooth)
        after, arrived = self._moved(state, sent)
        stock, moves = stock + arrived, []
        if "band" in parts:
            band, shift = parts["band"], parts["shift"]
            moves.append(move_before(case, constants, stock, band, shift, smooth))
            stock = moves[-1].stock
        asked = jnp.zeros(n, stock.dtype)
        # In training orders are no whole numbers, so that a derivative by whole demand, which is
        # right on lines that are straight between them, would be wrong.
        spread = not isinstance(smooth, Exact)
        for k, (i, demand) in enumerate(zip(case.sellers, self._sold)):
            asked = asked.at[i].set(demand.draw(constants["demand"][k], noise[k], spread))
        stock = stock - asked
        if "held" in parts:
            moves.append(move_after(case, constants, stock, parts["held"], smooth))
            stock = moves[-1].stock
        left = smooth.positive_part(stock, corner)
        short = left - stock
        sold = smooth.positive_part(asked - short, corner)  # goods that waited were met first
        costs, means = self._counted(constants, after, left, short, moves)
        levels = self._echelon(state) + parts["order"]
        means |= {f"level_{place.name}": levels[i] for i, place in enumerate(case.places)}
        means |= {"demand": asked.sum(), "sold": sold[jnp.asarray(case.sellers)].sum()}
        means["short"] = smooth.indicator(jnp.max(short) - 1e-3, corner[0])
        for i in case.sellers:
            name = case.places[i].name
            means |= {f"sold_{name}": sold[i], f"demand_{name}": asked[i]}
        outputs = {name: now["weight"] * each for name, each in costs.items()}
        outputs["result"] = -sum(outputs.values())
        outputs |= {name: now["counted"] * each for name, each in means.items()}
        after["stock"] = left if case.lost else stock
        return after, outputs

    def _counted(self, constants, after, left, short, moves):
        """(costs by part, averages of stock and of goods moved)."""
        case = self.case
        coming = after["coming"].sum(1) if self.longest else jnp.zeros_like(left)
        away = jnp.asarray(case.supplies, left.dtype) @ coming
        costs = {
            "holding": constants["holding"] @ (left + away),
            "shortage": constants["shortage"] @ short[jnp.asarray(case.sellers)],
        }
        means = {"stock": left.sum()}
        means |= {f"stock_{place.name}": left[i] for i, place in enumerate(case.places)}
        if moves:
            costs["transshipment"] = jnp.stack([each.cost for each in moves]).sum()
            given = jnp.stack([each.sent for each in moves]).sum(0)
            taken = jnp.stack([each.received for each in moves]).sum(0)
            means["moved"] = jnp.sum(taken)
            for i in sorted({*case.moving(False), *case.moving(True)}):
                name = case.places[i].name
                means |= {f"sent_{name}": given[i], f"received_{name}": taken[i]}
        return costs, means

    def _sent(self, constants, stock, wanted, smooth):
        """(stocks after sending [n], amounts sent to each place [n])."""
        supplies = jnp.asarray(self.case.supplies, stock.dtype)
        total = supplies @ wanted
        held = smooth.positive_part(stock, constants["corner"])
        # In this order, as stock is differentiated upwards where it is just what was asked for.
        given = smooth.minimum(held, total, constants["corner"])
        some = total > 0
        share = jnp.where(some, given, 1.0) / jnp.where(some, total, 1.0)
        outside = jnp.asarray([float(p.supplier is None) for p in self.case.places], stock.dtype)
        sent = wanted * outside
        for amounts, mine in zip(wanted * share[:, None], supplies):
            sent = sent + in_pieces(self.case, mine * amounts, smooth)
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

    def in_mean(self):
        """Parameters of whole demand."""
        names = [self.case.places[i].name for i in self.case.sellers]
        return tuple(
            f"{name}.{each.name}"
            for name, demand in zip(names, self._sold)
            if demand.integral()
            for each in demand.given()
        )

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
    costs = [case.holding, case.shortage, *([case.transshipment] if case.transshipment else [])]
    found = {each.name: each.input() for each in costs}
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
