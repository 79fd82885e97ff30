"""Twelve small simulators of the kinds that users write, each with three or four inputs.

Partial observation, a jump, chaos, a serial line, a put, hydro power, a regulator, a battery, a
portfolio with costs, lost sales with a lead time, a cart and its pole, and a swing contract.
"""

import jax
import jax.numpy as jnp

import snapo


class Given(snapo.Simulator):
    """Constants are the inputs; each subclass says its horizon, actions and noise."""

    horizon: int = 20
    action: snapo.Box = snapo.Box(-jnp.inf, jnp.inf)
    noise_size: int = 1
    initial_noise_size: int = 0

    def prepare(self, inputs):
        steps = {"left": 1 - jnp.arange(self.horizon) / self.horizon}
        return snapo.Schedule(dict(inputs), steps)


class Hidden(Given):
    """A hidden level moves by v and is seen through noise w; the cost is the distance to it."""

    noise_size: int = 2
    initial_noise_size: int = 1

    def initial(self, constants, noise):
        return {"x": noise[0], "seen": jnp.zeros(()), "guess": jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["seen"], state["guess"]])

    def step(self, constants, now, state, action, noise, smooth):
        x = constants["keep"] * state["x"] + constants["v"] * noise[0]
        loss = (state["x"] - action[0]) ** 2
        return {"x": x, "seen": x + constants["w"] * noise[1], "guess": action[0]}, {"value": -loss}


class Spill(Given):
    """A reservoir with a prize at its end where more than fifty are left: a jump."""

    horizon: int = 8
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return constants["water"]

    def observe(self, constants, now, state):
        return jnp.stack([state / 50 - 1, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        out = smooth.minimum(10 * action[0], state, scale=1.0)
        inflow = constants["inflow"] * jnp.exp(0.5 * noise[0] - 0.125)
        return state - out + inflow, {"value": constants["worth"] * out}

    def terminal(self, constants, state, smooth):
        return {"value": 40 * smooth.indicator(state - 50, 10.0)}


class Pendulum(Given):
    """Swings up from anywhere; the angle is unwrapped, its cost is periodic."""

    horizon: int = 60
    action: snapo.Box = snapo.Box(-2.0, 2.0)
    noise_size: int = 0
    initial_noise_size: int = 2

    def initial(self, constants, noise):
        return {"angle": noise[0], "speed": noise[1]}

    def observe(self, constants, now, state):
        return jnp.append(snapo.angle_features(state["angle"]), state["speed"] / 4)

    def step(self, constants, now, state, action, noise, smooth):
        angle, speed, torque = state["angle"], state["speed"], action[0]
        loss = snapo.wrap_angle(angle) ** 2 + 0.1 * speed**2 + 0.001 * torque**2
        fall = 1.5 * constants["g"] / constants["length"] * jnp.sin(angle)
        push = 3 * torque / (constants["mass"] * constants["length"] ** 2)
        speed = jnp.clip(speed + 0.05 * (fall + push), -8.0, 8.0)
        return {"angle": angle + 0.05 * speed, "speed": speed}, {"value": -loss}


class SerialLine(Given):
    """Two stocks one behind the other; the first one sells, the second one orders."""

    action: snapo.Box = snapo.Box(0.0, 20.0, 2)

    def initial(self, constants, noise):
        return jnp.array([8.0, 8.0])

    def observe(self, constants, now, state):
        return state / 10

    def step(self, constants, now, state, action, noise, smooth):
        shop, depot = state
        moved = smooth.minimum(action[0], depot, scale=1.0)
        demand = constants["demand"] * jnp.exp(0.4 * noise[0] - 0.08)
        shop = shop + moved - demand
        held, missing = smooth.positive_part(shop, 1.0), smooth.positive_part(-shop, 1.0)
        depot = depot - moved + action[1]
        loss = constants["holding"] * (held + 0.5 * depot) + constants["penalty"] * missing
        return jnp.stack([shop, depot]), {"value": -loss}


class Put(Given):
    """An American put, stopped at a rate."""

    horizon: int = 25
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return {"spot": constants["spot"], "alive": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.stack([10 * (state["spot"] / 40 - 1), now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        spot, alive, dt = state["spot"], state["alive"], 1 / self.horizon
        discount = jnp.exp(-constants["rate"] * (1 - now["left"]))
        paid = discount * smooth.positive_part(40 - spot, 1.0) * action[0] * alive
        drift = (constants["rate"] - constants["sigma"] ** 2 / 2) * dt
        spot = spot * jnp.exp(drift + constants["sigma"] * jnp.sqrt(dt) * noise[0])
        return {"spot": spot, "alive": alive * (1 - action[0])}, {"value": paid}

    def terminal(self, constants, state, smooth):
        last = jnp.exp(-constants["rate"]) * smooth.positive_part(40 - state["spot"], 1.0)
        return {"value": last * state["alive"]}


class Hydro(Given):
    """A reservoir between a wet inflow and a price, both random."""

    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 2

    def initial(self, constants, noise):
        return {"water": jnp.asarray(50.0), "wet": jnp.zeros(()), "price": jnp.zeros(())}

    def observe(self, constants, now, state):
        level = state["water"] / 50 - 1
        return jnp.stack([level, state["wet"], state["price"], now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        wet = 0.7 * state["wet"] + 0.4 * noise[0]
        price = 0.8 * state["price"] + 0.2 * noise[1]
        out = smooth.minimum(15 * action[0], state["water"], scale=1.0)
        room = state["water"] - out + constants["inflow"] * jnp.exp(wet)
        water = smooth.minimum(room, constants["dam"], scale=1.0)
        earned = constants["worth"] * jnp.exp(price) * out
        return {"water": water, "wet": wet, "price": price}, {"value": earned}


class Regulator(Given):
    """Two linked states, one force, quadratic costs."""

    noise_size: int = 2

    def initial(self, constants, noise):
        return jnp.array([1.0, 0.0])

    def observe(self, constants, now, state):
        return state

    def step(self, constants, now, state, action, noise, smooth):
        x, v = state
        loss = x**2 + 0.1 * v**2 + constants["force"] * action[0] ** 2
        v = 0.95 * v + constants["pull"] * x + action[0] + constants["shake"] * noise[0]
        return jnp.stack([x + 0.3 * v, v]), {"value": -loss}


class Battery(Given):
    """Buys and sells at a reverting price; half a cycle costs."""

    horizon: int = 48
    action: snapo.Box = snapo.Box(-1.0, 1.0)

    def initial(self, constants, noise):
        return {"energy": jnp.asarray(1.0), "price": jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["energy"] / 2 - 0.5, state["price"], now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        energy, price = state["energy"], jnp.exp(state["price"])
        after = smooth.clip(energy + action[0], 0.0, constants["size"], 0.2)
        flow = after - energy
        loss = constants["wear"] * smooth.absolute(flow, 0.2)
        cash = -flow * 40 * price * jnp.where(flow > 0, 1.0, constants["efficiency"]) - loss
        price = 0.7 * state["price"] + 0.3 * noise[0]
        return {"energy": after, "price": price}, {"value": cash}


class Portfolio(Given):
    """A share of wealth in stocks whose moves cost; the value is the mean of a utility."""

    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return {"wealth": jnp.ones(()), "share": jnp.asarray(0.5)}

    def observe(self, constants, now, state):
        return jnp.stack([state["share"], now["left"], jnp.log(state["wealth"])])

    def step(self, constants, now, state, action, noise, smooth):
        moved = smooth.absolute(action[0] - state["share"], 0.05)
        wealth = state["wealth"] * (1 - constants["cost"] * moved)
        growth = jnp.exp(constants["drift"] - constants["sigma"] ** 2 / 2)
        stock = action[0] * growth * jnp.exp(constants["sigma"] * noise[0])
        total = stock + 1 - action[0]
        return {"wealth": wealth * total, "share": stock / total}, {}

    def terminal(self, constants, state, smooth):
        return {"value": 1 - state["wealth"] ** -3}


class LostSales(Given):
    """Orders arrive two periods later; demand that finds no stock is lost."""

    action: snapo.Box = snapo.Box(0.0, 15.0)

    def initial(self, constants, noise):
        return {"stock": jnp.asarray(10.0), "coming": jnp.array([5.0, 5.0])}

    def observe(self, constants, now, state):
        return jnp.concatenate([state["stock"][None], state["coming"]]) / 10

    def step(self, constants, now, state, action, noise, smooth):
        demand = constants["demand"] * jnp.exp(0.5 * noise[0] - 0.125)
        left = smooth.positive_part(state["stock"] - demand, 1.0)
        lost = smooth.positive_part(demand - state["stock"], 1.0)
        loss = constants["holding"] * left + constants["penalty"] * lost
        coming = jnp.stack([state["coming"][1], action[0]])
        return {"stock": left + state["coming"][0], "coming": coming}, {"value": -loss}


class CartPole(Given):
    """A pole on a cart, near its upright rest; shocks push the cart."""

    horizon: int = 50
    action: snapo.Box = snapo.Box(-10.0, 10.0)

    def initial(self, constants, noise):
        return jnp.array([0.0, 0.0, 0.1, 0.0])

    def observe(self, constants, now, state):
        return state * jnp.array([1.0, 0.5, 3.0, 1.0])

    def step(self, constants, now, state, action, noise, smooth):
        x, v, angle, spin = state
        pole, length, total = constants["pole"], constants["length"], 1 + constants["pole"]
        force = action[0] + constants["shake"] * noise[0]
        pushed = (force + pole * length * spin**2 * jnp.sin(angle)) / total
        turn = 9.8 * jnp.sin(angle) - jnp.cos(angle) * pushed
        turn = turn / (length * (4 / 3 - pole * jnp.cos(angle) ** 2 / total))
        push = pushed - pole * length * turn * jnp.cos(angle) / total
        after = jnp.stack([x + 0.02 * v, v + 0.02 * push, angle + 0.02 * spin, spin + 0.02 * turn])
        return after, {"value": -(x**2 + 10 * angle**2 + 0.001 * action[0] ** 2)}


class Swing(Given):
    """Ten units of gas to be bought over twenty days at a strike, at most one a day."""

    action: snapo.Box = snapo.Box(0.0, 1.0)

    def initial(self, constants, noise):
        return {"bought": jnp.zeros(()), "price": jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["bought"] / 5 - 1, 3 * state["price"], now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        amount = smooth.minimum(action[0], constants["rights"] - state["bought"], scale=0.5)
        cash = amount * (20 * jnp.exp(state["price"]) - constants["strike"])
        price = 0.9 * state["price"] + constants["sigma"] * noise[0]
        return {"bought": state["bought"] + amount, "price": price}, {"value": cash}


INPUTS = {
    Hidden: {"keep": 0.8, "v": 0.6, "w": 0.7},
    Spill: {"water": 48.0, "inflow": 8.0, "worth": 2.0},
    Pendulum: {"g": 10.0, "length": 1.0, "mass": 1.0},
    SerialLine: {"demand": 5.0, "holding": 1.0, "penalty": 9.0},
    Put: {"spot": 36.0, "rate": 0.06, "sigma": 0.2},
    Hydro: {"inflow": 8.0, "dam": 100.0, "worth": 3.0},
    Regulator: {"pull": 0.2, "force": 0.1, "shake": 0.3},
    Battery: {"size": 2.0, "wear": 1.0, "efficiency": 0.9},
    Portfolio: {"cost": 0.01, "drift": 0.02, "sigma": 0.08},
    LostSales: {"demand": 5.0, "holding": 1.0, "penalty": 9.0},
    CartPole: {"pole": 0.1, "length": 0.5, "shake": 1.0},
    Swing: {"rights": 10.0, "strike": 20.0, "sigma": 0.15},
}


def problem(kind: type[Given]) -> snapo.Problem:
    """The problem of one of them: the mean of its only output."""
    inputs = {name: snapo.Input(number) for name, number in INPUTS[kind].items()}
    return snapo.Problem(kind(), inputs, snapo.Mean("value"))


def policy(of: snapo.Problem) -> snapo.Policy:
    """A small network."""
    return snapo.MLP(hidden=(16, 16)).for_problem(of.interface, jax.random.key(0))
