"""Benchmark problems that are solved with no settings at all; `references.py` has their optima.

A battery that decides 24 powers a day for a year, four reservoirs beside thermal plants, twelve
stocks, and a cart that swings its pole up. The regulator, the put and the pendulum stand where they were first used.
"""

import jax
import jax.numpy as jnp
import numpy as np

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.cart_pole import CartPole

DAYS, HOURS = 365, 24
POWER, SIZE, EFFICIENCY, WEAR = 1.0, 4.0, 0.92, 2.0  # MW, MWh, each way, EUR/MWh of flow
SHAPE = np.array(
    [-8, -11, -13, -14, -12, -6, 4, 13, 15, 9, 2, -5, -10, -12, -9, -2, 7, 17, 23, 20, 11, 4, -1, -5]
)  # fmt: skip
LEVEL, DAILY, HOURLY = 60.0, 0.08, 8.0  # EUR/MWh; of its logarithm by day; EUR/MWh by hour
STAYS, STAYS_HOUR = 0.9, 0.6  # how much of a deviation is left after a day; after an hour


class Battery(snapo.Simulator):
    """Sees the 24 prices of the day and decides 24 powers, which its energy cuts off, hour by hour.

    A power is the share of 1 MW that charges (above 0) or discharges. Hourly prices are a level,
    which wanders from day to day, plus the shape of a day, plus noise that an hour hands on.
    """

    horizon: int = DAYS
    action: snapo.Box = snapo.Box(-1.0, 1.0, HOURS)
    noise_size: int = HOURS + 1
    initial_noise_size: int = HOURS + 1

    def prepare(self, inputs):
        season = 1 + 0.15 * jnp.cos(2 * jnp.pi * jnp.arange(self.horizon + 1) / DAYS)
        constants = dict(inputs) | {"first": season[0], "shape": jnp.asarray(SHAPE, float)}
        return snapo.Schedule(constants, {"after": season[1:]})

    def initial(self, constants, noise):
        level = DAILY / jnp.sqrt(1 - STAYS**2) * noise[0]
        return {
            "energy": jnp.zeros(()),
            "level": level,
            "prices": prices(constants, constants["first"], level, noise[1:]),
        }

    def observe(self, constants, now, state):
        return jnp.append(state["prices"] / 50 - 1, state["energy"] / 2 - 1)

    def step(self, constants, now, state, action, noise, smooth):
        energy, cash = state["energy"], jnp.zeros(())
        for hour in range(HOURS):
            after = smooth.clip(energy + POWER * action[hour], 0.0, constants["size"], POWER)
            flow = after - energy
            into, out = smooth.positive_part(flow, POWER), smooth.positive_part(-flow, POWER)
            price, wear = state["prices"][hour], constants["wear"]
            cash += out * (price * EFFICIENCY - wear) - into * (price / EFFICIENCY + wear)
            energy = after
        level = STAYS * state["level"] + DAILY * noise[0]
        after = prices(constants, now["after"], level, noise[1:])
        return {"energy": energy, "level": level, "prices": after}, {"cash": cash}


def prices(constants, season, level, noise):
    """[24] EUR/MWh of a day."""
    found, deviation = [], jnp.zeros(())
    for hour in range(HOURS):
        deviation = STAYS_HOUR * deviation + HOURLY * noise[hour]
        found.append(deviation)
    base = constants["level"] * season * jnp.exp(level)
    return base + constants["shape"] + jnp.stack(found)


BATTERY = {"level": snapo.Input(LEVEL), "size": snapo.Input(SIZE), "wear": snapo.Input(WEAR)}

MONTHS, OUTCOMES = 12, 24
STORES = np.array([100.0, 60.0, 40.0, 25.0])  # hm3, from the largest to the smallest
TURBINES = np.array([22.0, 20.0, 14.0, 12.0])  # hm3 a month, at most
YIELD = np.array([1.2, 0.9, 0.7, 0.8])  # GWh for a hm3
MEANS = np.array([12.0, 9.0, 7.0, 6.0])  # hm3 a month, on average over a year
THERMAL, COSTS = np.array([10.0, 15.0, 30.0]), np.array([20.0, 45.0, 90.0])  # GWh; kEUR/GWh
SHORTAGE, WORTH = 400.0, 50.0  # kEUR/GWh not served; kEUR/GWh of water left at the end
DEMAND = 70 + 12 * np.cos(2 * np.pi * np.arange(MONTHS) / 12)  # GWh
WET = 1 + 0.6 * np.cos(2 * np.pi * (np.arange(MONTHS + 1) - 4) / 12)
FIRST = 0.6 * STORES  # before the first month's inflow


def inflows() -> np.ndarray:
    """[13, 24, 4] hm3: equally likely inflows of every month, all alike in the first one."""
    rng = np.random.default_rng(4)
    common = 0.5 * rng.standard_normal((MONTHS + 1, OUTCOMES, 1))
    own = 0.4 * rng.standard_normal((MONTHS + 1, OUTCOMES, 4))
    size = np.exp(common + own)
    size[0] = 1.0
    return MEANS * WET[:, None, None] * size / size.mean(1, keepdims=True)


class Hydro(snapo.Simulator):
    """Four reservoirs, the first above the second, and thermal plants that serve the rest.

    A month's inflow is known when its releases are decided, as in dynamic programming with water
    on hand; releases are shares of the turbines. What does not fit is spilt.
    """

    horizon: int = MONTHS
    action: snapo.Box = snapo.Box(0.0, 1.0, 4)
    noise_size: int = 1

    def prepare(self, inputs):
        every, year = jnp.asarray(inflows()), jnp.arange(MONTHS) / MONTHS
        steps = {
            "inflow": every[1:],
            "demand": inputs["demand"],
            "clock": jnp.stack(
                [1 - year, jnp.cos(2 * jnp.pi * year), jnp.sin(2 * jnp.pi * year)], 1
            ),
        }
        tables = {"turbines": TURBINES, "stores": STORES, "yield": YIELD}
        constants = {name: jnp.asarray(table) for name, table in tables.items()}
        return snapo.Schedule(constants | {"first": inputs["first"] + every[0, 0]}, steps)

    def initial(self, constants, noise):
        return constants["first"]

    def observe(self, constants, now, state):
        return jnp.concatenate([2 * state / constants["stores"] - 1, now["clock"]])

    def step(self, constants, now, state, action, noise, smooth):
        out = smooth.minimum(constants["turbines"] * action, state, scale=10.0)
        rest = (state - out).at[1].add(out[0])
        kept = smooth.minimum(rest, constants["stores"], scale=10.0)
        missing, cost = now["demand"] - constants["yield"] @ out, jnp.zeros(())
        steps = np.diff(np.append(COSTS, SHORTAGE), prepend=0.0).tolist()
        for above, more in zip([0.0, *np.cumsum(THERMAL).tolist()], steps):
            cost += more * smooth.positive_part(missing - above, 10.0)
        which = jnp.floor(OUTCOMES * jax.scipy.special.ndtr(noise[0])).astype(int)
        inflow = now["inflow"][jnp.clip(which, 0, OUTCOMES - 1)]
        return kept + inflow, {"value": -cost}

    def terminal(self, constants, state, smooth):
        # The inflow of a month that is not decided any more is the same for every rule.
        return {"value": WORTH * constants["yield"] @ state}


HYDRO = {"first": snapo.Input(FIRST), "demand": snapo.Input(DEMAND)}
GOODS, PERIODS = 12, 20
SOLD = np.linspace(4.0, 15.0, GOODS)  # mean demand of a period; its deviation is .3 of it
SHORT = np.linspace(3.0, 19.0, GOODS)  # a unit that waits for a period, where holding one costs 1


class Stocks(snapo.Simulator):
    """Twelve goods that have nothing in common; orders come at once, and demand waits."""

    horizon: int = PERIODS
    action: snapo.Box = snapo.Box(0.0, 60.0, GOODS)
    noise_size: int = GOODS

    def prepare(self, inputs):
        constants = {"sold": jnp.asarray(SOLD, float), "short": jnp.asarray(SHORT, float)}
        return snapo.Schedule(constants, {"time": jnp.arange(PERIODS) / PERIODS})

    def initial(self, constants, noise):
        return jnp.zeros(GOODS)

    def observe(self, constants, now, state):
        return state / constants["sold"]

    def step(self, constants, now, state, action, noise, smooth):
        after = state + action - constants["sold"] * (1 + 0.3 * noise)
        over = smooth.positive_part(after, 5.0)
        cost = over.sum() + constants["short"] @ smooth.positive_part(-after, 5.0)
        return after, {"value": -cost}


MONTH, AVERSE, LEAST = 1 / 12, 5.0, 1e-3


class Saver(snapo.Simulator):
    """Ten years of a wealth of 1, part in a stock and part consumed, under a power utility.

    As a first attempt writes it: wealth and consumption with a floor, below which no decision
    matters, so that paths near ruin are worth -2.5e11 and the best rule earns -2.3e4.
    """

    horizon: int = 120
    action: snapo.Box = snapo.Box((-1.0, 0.0), (4.0, 1.0))  # the stock's weight, consumption
    noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"year": jnp.arange(self.horizon) * MONTH})

    def initial(self, constants, noise):
        return {"wealth": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.stack([jnp.log(jnp.maximum(state["wealth"], LEAST)), now["year"] / 10])

    def step(self, constants, now, state, action, noise, smooth):
        over = (constants["drift"] - constants["rate"]) * MONTH
        over = over + constants["volatility"] * MONTH**0.5 * noise[0]
        consumed = action[1] * state["wealth"]
        grown = (state["wealth"] - consumed) * (1 + constants["rate"] * MONTH + action[0] * over)
        return {"wealth": jnp.maximum(grown, LEAST)}, {
            "utility": MONTH * utility(jnp.maximum(consumed / MONTH, LEAST))
        }

    def terminal(self, constants, state, smooth):
        return {"utility": utility(state["wealth"])}


def utility(amount):
    return amount ** (1 - AVERSE) / (1 - AVERSE)


SAVER = {"rate": 0.02, "drift": 0.07, "volatility": 0.2}

UPRIGHT = np.cos(np.radians(12))  # of the angle: within it Gymnasium's CartPole-v1 goes on


def cart() -> snapo.Problem:
    """Five seconds from hanging, with the numbers of PILCO (see `CartPole`)."""
    inputs = make_inputs(CartPole)
    return snapo.Problem(CartPole(inputs), inputs, snapo.Mean("reward"))


def upright(problem: snapo.Problem, policy: snapo.Policy, paths: int = 2048) -> float:
    """The share of the second half of the steps in which the pole is within 12 degrees."""
    draws = problem.sources.evaluation.draws(np.arange(paths), problem.simulator)
    bound = snapo.Xla().bind(problem)
    rolled = bound.values(policy, draws, snapo.Exact(), record=("state",))
    angle = np.asarray(rolled.record["state"]["angle"])
    return float(np.mean(np.cos(angle[len(angle) // 2 :]) > UPRIGHT))
