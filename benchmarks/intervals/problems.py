"""Eighteen small problems whose best value is known, as simulators: one to sixty steps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

import snapo
from snapo import noise as draws

from . import references


@dataclass(frozen=True)
class Known:
    """A problem and the exact value of its best policy as a function of the inputs."""

    simulator: snapo.Simulator
    value: Callable[..., float]
    at: Mapping[str, Any]
    objective: snapo.Objective
    policy: snapo.Policy | None = None

    @property
    def inputs(self) -> dict[str, snapo.Input]:
        """The inputs of the simulator."""
        return {name: snapo.Input(number) for name, number in self.at.items()}


def countdown(steps: int):
    """[T] the share of the steps that remains."""
    return (steps - jnp.arange(float(steps))) / steps


class FixedOrder(snapo.Simulator):
    horizon: int = 50
    noise_size: int = 2
    action: snapo.Product = snapo.Product(order=snapo.Choice(2), size=snapo.Integers(0, 40))

    def prepare(self, inputs):
        demand = draws.prepare(draws.Poisson(inputs["mean"], maximum=30))
        return snapo.Schedule({**inputs, "demand": demand}, {"left": countdown(50)})

    def in_mean(self):
        return ("mean",)

    def initial(self, constants, noise):
        return {"level": jnp.asarray(6.0), "weight": jnp.asarray(1.0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["level"] / 10, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        parts = self.action.parts(action)
        option, likelihood = self.action["order"].draw(parts["order"], noise[1])
        weight = state["weight"] * likelihood
        level = state["level"] + option[1] * parts["size"][0]
        level = level - constants["demand"].draw(noise[:1])
        stock, short = (smooth.positive_part(x, 5.0) for x in (level, -level))
        cost = constants["K"] * option[1] + constants["h"] * stock + constants["p"] * short
        return {"level": level, "weight": weight}, {"cash": -(8.0 + weight * (cost - 8.0))}


class LostSales(snapo.Simulator):
    horizon: int = 30
    noise_size: int = 1
    action: snapo.Integers = snapo.Integers(0, 20)

    def prepare(self, inputs):
        demand = draws.prepare(draws.Poisson(inputs["mean"], maximum=30))
        return snapo.Schedule({**inputs, "demand": demand}, {"left": countdown(30)})

    def in_mean(self):
        return ("mean",)

    def initial(self, constants, noise):
        return {"stock": jnp.asarray(5.0), "coming": jnp.asarray(5.0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] / 5 - 1, state["coming"] / 5 - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        demand = constants["demand"].draw(noise[:1])
        left = smooth.positive_part(state["stock"] - demand, 5.0)
        short = smooth.positive_part(demand - state["stock"], 5.0)
        cost = constants["h"] * left + constants["p"] * short + constants["c"] * action[0]
        return {"stock": left + state["coming"], "coming": action[0]}, {"cash": -cost}


class DualSourcing(snapo.Simulator):
    horizon: int = 60
    noise_size: int = 1
    action: snapo.Integers = snapo.Integers(0, 8, 2)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"left": countdown(60)})

    def initial(self, constants, noise):
        return {"stock": jnp.asarray(6.0), "next": jnp.asarray(0.0), "later": jnp.asarray(0.0)}

    def observe(self, constants, now, state):
        arriving = (state["stock"] + state["next"]) / 4 - 1
        return jnp.stack([arriving, state["later"] / 2 - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        demand = jnp.minimum(jnp.floor(5 * draws.uniform(noise[0])), 4.0)
        stock = state["stock"] + state["next"] + action[0] - jax.lax.stop_gradient(demand)
        left, short = (smooth.positive_part(x, 2.0) for x in (stock, -stock))
        cost = constants["ce"] * action[0] + constants["h"] * left + constants["b"] * short
        after = {"stock": stock, "next": state["later"], "later": action[1]}
        return after, {"cash": -cost}


class Put(snapo.Simulator):
    horizon: int = 20
    noise_size: int = 1
    action: snapo.Stop = snapo.Stop()

    def prepare(self, inputs):
        year, volatility = jnp.arange(20.0) / 20, inputs["volatility"]
        drift = (inputs["rate"] - volatility**2 / 2) / 20
        steps = {"left": 1 - year, "discount": jnp.exp(-inputs["rate"] * year)}
        return snapo.Schedule({**inputs, "drift": drift, "deviation": volatility / 20**0.5}, steps)

    def initial(self, constants, noise):
        return {"spot": constants["spot"], "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([5 * jnp.log(state["spot"] / constants["strike"]), now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        paid = jnp.maximum(constants["strike"] - state["spot"], 0.0)
        move = jnp.exp(constants["drift"] + constants["deviation"] * noise[0])
        after = {"spot": state["spot"] * move, "right": right}
        return after, {"cash": used * now["discount"] * paid}

    def terminal(self, constants, state, smooth):
        paid = jnp.maximum(constants["strike"] - state["spot"], 0.0)
        left = self.action.left(state["right"])
        return {"cash": left * jnp.exp(-constants["rate"]) * paid}


class Regulator(snapo.Simulator):
    horizon: int = 20
    noise_size: int = 1
    action: snapo.Box = snapo.Box(-jnp.inf, jnp.inf)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"left": countdown(20)})

    def initial(self, constants, noise):
        return constants["x0"]

    def observe(self, constants, now, state):
        return jnp.stack([state, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        cost = constants["q"] * state**2 + constants["r"] * action[0] ** 2
        after = constants["a"] * state + constants["b"] * action[0] + constants["s"] * noise[0]
        return after, {"cash": -cost}


class MeasuredRegulator(snapo.Simulator):
    horizon: int = 20
    noise_size: int = 2
    initial_noise_size: int = 2
    action: snapo.Box = snapo.Box(-5.0, 5.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(20.0)})

    def initial(self, constants, noise):
        level = constants["s0"] * noise[0]
        return {"level": level, "seen": level + constants["v"] * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        level = state["level"] + action[0] + constants["w"] * noise[0]
        cost = state["level"] ** 2 + constants["r"] * action[0] ** 2
        return {"level": level, "seen": level + constants["v"] * noise[1]}, {"cash": -cost}


class Once(snapo.Simulator):
    """One step whose constants are the inputs, without any observation."""

    horizon: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(1)})

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def initial(self, constants, noise):
        return jnp.zeros(())


class Newsvendor(Once):
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 100.0)

    def step(self, constants, now, state, action, noise, smooth):
        demand = constants["mean"] + constants["sd"] * noise[0]
        left, short = (smooth.positive_part(s * (action[0] - demand), 10.0) for s in (1, -1))
        return state, {"cash": -(constants["h"] * left + constants["p"] * short)}


class Merton(snapo.Simulator):
    horizon: int = 12
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"left": countdown(12)})

    def initial(self, constants, noise):
        return jnp.asarray(1.0)

    def observe(self, constants, now, state):
        return jnp.stack([state - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        deviation = constants["volatility"]
        drift = (constants["drift"] - deviation**2 / 2) / 4
        stock = jnp.exp(drift + deviation / 2 * noise[0])
        cash = jnp.exp(constants["rate"] / 4)
        return state * (action[0] * stock + (1 - action[0]) * cash), {}

    def terminal(self, constants, state, smooth):
        return {"wealth": state}


class AtLimit(snapo.Simulator):
    horizon: int = 8
    noise_size: int = 2
    action: snapo.Simplex = snapo.Simplex(2)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"left": countdown(8)})

    def initial(self, constants, noise):
        return jnp.asarray(1.0)

    def observe(self, constants, now, state):
        return jnp.stack([state - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        def grown(name, shock):
            deviation = constants[f"sd_{name}"]
            return jnp.exp((constants[f"mu_{name}"] - deviation**2 / 2) / 4 + deviation / 2 * shock)

        return state * (action[0] * grown("a", noise[0]) + action[1] * grown("b", noise[1])), {}

    def terminal(self, constants, state, smooth):
        return {"wealth": state}


class Digital(Once):
    noise_size: int = 1
    initial_noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        deviation = constants["sd0"]
        return constants["spot"] * jnp.exp(deviation * noise[0] - deviation**2 / 2)

    def observe(self, constants, now, state):
        return jnp.stack([10 * jnp.log(state / 100.0)])

    def step(self, constants, now, state, action, noise, smooth):
        deviation = constants["sd1"]
        last = state * jnp.exp(deviation * noise[0] - deviation**2 / 2)
        won = smooth.indicator(last - constants["strike"], 20.0)
        effort = constants["cost"] * action[0] ** 2 / 2
        return state, {"cash": constants["prize"] * action[0] * won - effort}


class Store(snapo.Simulator):
    """A store; `relative`: the policy observes the price relative to the forward price."""

    horizon: int = 16
    noise_size: int = 1
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    relative: bool = False

    def prepare(self, inputs):
        t, phi = jnp.arange(16.0), inputs["phi"]
        variance = inputs["sigma"] ** 2 * (1 - phi ** (2 * t)) / (1 - phi**2)
        steps = {"forward": inputs["curve"], "half": variance / 2, "left": (16 - t) / 16}
        return snapo.Schedule({n: x for n, x in inputs.items() if n != "curve"}, steps)

    def initial(self, constants, noise):
        return {"factor": jnp.asarray(0.0), "volume": jnp.asarray(0.0)}

    def observe(self, constants, now, state):
        price = self.price(now, state)
        seen = 5 * (state["factor"] - now["half"]) if self.relative else price / 4 - 5
        angle, volume = 2 * jnp.pi * now["left"], 2 * state["volume"]
        season = (jnp.sin(angle), jnp.cos(angle), volume * jnp.cos(angle))
        return jnp.stack([seen, volume - 1, now["left"], *season])

    def price(self, now, state):
        return now["forward"] * jnp.exp(state["factor"] - now["half"])

    def step(self, constants, now, state, action, noise, smooth):
        price, rate = self.price(now, state), constants["rate"]
        wanted = (rate * smooth.positive_part(sign * action[0], 1.0) for sign in (1, -1))
        into, out = next(wanted), next(wanted)
        into = smooth.minimum(into, constants["cap"] - state["volume"], 0.25)
        out = smooth.minimum(out, state["volume"], 0.25)
        cash = (price - constants["out"]) * out - (price + constants["into"]) * into
        factor = constants["phi"] * state["factor"] + constants["sigma"] * noise[0]
        return {"factor": factor, "volume": state["volume"] + into - out}, {"cash": cash}


class Growth(snapo.Simulator):
    horizon: int = 30
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.01, 0.99)

    def prepare(self, inputs):
        t = jnp.arange(30.0)
        steps = {"discount": inputs["beta"] ** t, "left": (30 - t) / 30, "last": (t == 29) * 1.0}
        return snapo.Schedule({n: x for n, x in inputs.items() if n != "beta"}, steps)

    def initial(self, constants, noise):
        return jnp.log(constants["y0"])

    def observe(self, constants, now, state):
        return jnp.stack([state, now["left"], now["last"]])

    def step(self, constants, now, state, action, noise, smooth):
        saved = action[0] * (1 - now["last"])
        utility = state + jnp.log(1 - saved)
        capital = state + jnp.log(jnp.maximum(saved, 1e-6))
        after = constants["mu"] + constants["s"] * noise[0] + constants["alpha"] * capital
        return after, {"utility": now["discount"] * utility}


class Signal(Once):
    noise_size: int = 0
    initial_noise_size: int = 2
    action: snapo.Box = snapo.Box(-jnp.inf, jnp.inf)

    def initial(self, constants, noise):
        hidden = jnp.sqrt(constants["v"]) * noise[0]
        return {"hidden": hidden, "seen": hidden + jnp.sqrt(constants["w"]) * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"reward": -((state["hidden"] - action[0]) ** 2)}


class Allocation(Once):
    noise_size: int = 0
    initial_noise_size: int = 1
    action: snapo.Simplex = snapo.Simplex(3)

    def initial(self, constants, noise):
        return constants["c1"] * jnp.exp(constants["sd"] * noise[0] - constants["sd"] ** 2 / 2)

    def observe(self, constants, now, state):
        return jnp.stack([jnp.log(state)])

    def step(self, constants, now, state, action, noise, smooth):
        money = jnp.maximum(constants["budget"] * action, 1e-9)
        returns = jnp.stack([state, constants["c2"], constants["c3"]])
        return state, {"return": jnp.sum(returns * jnp.sqrt(money))}


class Batches(snapo.Simulator):
    horizon: int = 20
    noise_size: int = 2
    action: snapo.Choice = snapo.Choice(3)

    def prepare(self, inputs):
        demand = draws.prepare(draws.Poisson(inputs["mean"], maximum=30))
        return snapo.Schedule({**inputs, "demand": demand}, {"left": countdown(20)})

    def in_mean(self):
        return ("mean",)

    def initial(self, constants, noise):
        return {"stock": jnp.asarray(4.0), "weight": jnp.asarray(1.0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] / 4 - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        option, likelihood = self.action.draw(action, noise[1])
        weight = state["weight"] * likelihood
        full = jnp.minimum(state["stock"] + option @ jnp.asarray([0.0, 4.0, 8.0]), 30.0)
        left = full - constants["demand"].draw(noise[:1])
        stock, short = (smooth.positive_part(x, 4.0) for x in (left, -left))
        made = constants["k"] * (option @ jnp.asarray([0.0, 1.0, 1.6]))
        cost = made + constants["h"] * stock + constants["p"] * short
        return {"stock": stock, "weight": weight}, {"cash": -(4.0 + weight * (cost - 4.0))}


class Offers(snapo.Simulator):
    horizon: int = 11
    noise_size: int = 1
    initial_noise_size: int = 1
    action: snapo.Stop = snapo.Stop()

    def prepare(self, inputs):
        t, beta = jnp.arange(11.0), inputs["beta"]
        return snapo.Schedule(dict(inputs), {"left": countdown(11), "discount": beta**t})

    def offer(self, constants, normal):
        width = constants["high"] - constants["low"]
        return constants["low"] + width * draws.uniform(normal)

    def initial(self, constants, noise):
        return {"offer": self.offer(constants, noise[0]), "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([state["offer"] / 5 - 3, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        before = self.action.left(state["right"])
        right, used = self.action.use(state["right"], action)
        waiting = (before - used) * now["discount"] * constants["wait"]
        after = {"offer": self.offer(constants, noise[0]), "right": right}
        return after, {"cash": used * now["discount"] * state["offer"] - waiting}

    def terminal(self, constants, state, smooth):
        last = constants["beta"] ** 11.0 * state["offer"]
        return {"cash": self.action.left(state["right"]) * last}


class Cake(snapo.Simulator):
    horizon: int = 10
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.01, 0.99)

    def prepare(self, inputs):
        t = jnp.arange(10.0)
        steps = {"discount": inputs["beta"] ** t, "left": (10 - t) / 10, "last": (t == 9) * 1.0}
        return snapo.Schedule({n: x for n, x in inputs.items() if n != "beta"}, steps)

    def initial(self, constants, noise):
        return constants["x0"]

    def observe(self, constants, now, state):
        return jnp.stack([jnp.log(state), now["left"], now["last"]])

    def step(self, constants, now, state, action, noise, smooth):
        eaten = state * (action[0] * (1 - now["last"]) + now["last"])
        move = constants["mu"] - constants["sd"] ** 2 / 2 + constants["sd"] * noise[0]
        left = jnp.maximum(state - eaten, 1e-9) * jnp.exp(move)
        return left, {"utility": -now["discount"] / eaten}


def utility(gamma: float) -> snapo.Objective:
    return snapo.ExpectedUtility("wealth", snapo.CRRA(gamma))


CASH = snapo.Mean("cash")
STORE = {
    "curve": references.CURVE, "sigma": 0.12, "phi": 0.8, "into": 0.3, "out": 0.2, "cap": 1.1,
    "rate": 0.25,
}  # fmt: skip
PROBLEMS = {
    "fixed order": Known(
        FixedOrder(), references.fixed_order, {"K": 5.0, "h": 1.0, "p": 4.0, "mean": 6.0}, CASH
    ),
    "lost sales": Known(
        LostSales(), references.lost_sales, {"h": 1.0, "p": 4.0, "c": 0.5, "mean": 5.0}, CASH
    ),
    "dual sourcing": Known(
        DualSourcing(), references.dual_sourcing, {"ce": 20.0, "h": 5.0, "b": 495.0}, CASH
    ),
    "put": Known(
        Put(),
        references.put,
        {"spot": 36.0, "strike": 40.0, "rate": 0.06, "volatility": 0.2},
        CASH,
    ),
    "regulator": Known(
        Regulator(),
        references.regulator,
        {"a": 0.9, "b": 0.5, "q": 1.0, "r": 0.3, "s": 0.4, "x0": 1.0},
        CASH,
    ),
    "measured regulator": Known(
        MeasuredRegulator(),
        references.measured_regulator,
        {"r": 0.5, "w": 0.3, "v": 0.7, "s0": 1.0},
        CASH,
        snapo.GRU(hidden=16),
    ),
    "newsvendor": Known(
        Newsvendor(), references.newsvendor, {"h": 0.18, "p": 0.7, "mean": 50.0, "sd": 8.0}, CASH
    ),
    "merton": Known(
        Merton(), references.merton, {"rate": 0.02, "drift": 0.06, "volatility": 0.2}, utility(3.0)
    ),
    "at a limit": Known(
        AtLimit(),
        references.at_limit,
        {"mu_a": 0.08, "mu_b": 0.01, "sd_a": 0.15, "sd_b": 0.2},
        utility(2.0),
    ),
    "digital": Known(
        Digital(),
        references.digital,
        {"strike": 100.0, "spot": 98.0, "sd0": 0.1, "sd1": 0.1, "prize": 1.0, "cost": 1.0},
        CASH,
    ),
    "store": Known(Store(), references.store, STORE, CASH),
    "store, relative price": Known(Store(relative=True), references.store, STORE, CASH),
    "growth": Known(
        Growth(),
        references.growth,
        {"alpha": 0.4, "beta": 0.96, "mu": 0.05, "s": 0.1, "y0": 1.0},
        snapo.Mean("utility"),
    ),
    "signal": Known(Signal(), references.signal, {"v": 2.0, "w": 1.0}, snapo.Mean("reward")),
    "allocation": Known(
        Allocation(),
        references.allocation,
        {"c1": 1.0, "c2": 0.7, "c3": 0.4, "sd": 0.3, "budget": 2.0},
        snapo.Mean("return"),
    ),
    "batches": Known(
        Batches(), references.batches, {"k": 2.0, "h": 0.5, "p": 3.0, "mean": 3.0}, CASH
    ),
    "offers": Known(
        Offers(), references.offers, {"low": 10.0, "high": 20.0, "beta": 0.97, "wait": 0.2}, CASH
    ),
    "cake": Known(
        Cake(),
        references.cake,
        {"beta": 0.95, "mu": 0.03, "sd": 0.2, "x0": 1.0},
        snapo.Mean("utility"),
    ),
}
