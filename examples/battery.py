"""A grid battery on an hourly market: it earns from price differences and ages.

The problem has one week of hours. The price is a mean-reverting deviation around a daily profile;
any other `Process` can replace it. Charging and discharging lose energy. Each cycle and each hour
reduce the capacity. At the end the lost capacity is paid at its replacement cost, and the energy in
store is sold at the mean forward price of the last day. The decision is the power as a share of the
rated power: +1 discharges and -1 charges at full power.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import snapo
from snapo import Process, Schwartz, SchwartzInputs

HOURS = 168


class Inputs(eqx.Module):
    """The differentiable inputs: the forward prices of the week by hour, and the battery's data."""

    price: SchwartzInputs
    power: snapo.Input
    capacity: snapo.Input
    efficiency: snapo.Input
    cycle_ageing: snapo.Input
    calendar_ageing: snapo.Input
    replacement: snapo.Input


class Battery(snapo.Simulator):
    """One path. State: energy in store (MWh), capacity (MWh), state of the price, and cycles."""

    price: Process = Schwartz(range(HOURS), time_scale=24.0)
    horizon: int = HOURS
    action: snapo.Box = snapo.Box(-1.0, 1.0)

    @property
    def noise_size(self):
        return self.price.noise_size

    @property
    def initial_noise_size(self):
        return self.price.initial_noise_size

    def prepare(self, inputs: Inputs) -> snapo.Schedule:
        prices = self.price.prepare(inputs.price)
        forward = jax.vmap(lambda now: self.price.forward(prices.constants, now))(prices.steps)
        hour = jnp.arange(HOURS)
        # For the policy: mean, highest and lowest forward price of the next 24 hours.
        ahead = forward[jnp.minimum(hour[:, None] + jnp.arange(24), HOURS - 1)]
        steps = {
            "price": prices.steps,
            "forward": forward,
            "mean": ahead.mean(1),
            "high": ahead.max(1),
            "low": ahead.min(1),
            "left": 1 - hour / HOURS,
        }
        constants = {
            "price": prices.constants,
            "power": inputs.power,
            "capacity": inputs.capacity,
            "efficiency": inputs.efficiency,
            "cycle_ageing": inputs.cycle_ageing,
            "calendar_ageing": inputs.calendar_ageing / (365 * 24),
            "replacement": inputs.replacement,
            "spread": forward.max() - forward.min(),
            "last_price": forward[-24:].mean(),
        }
        return snapo.Schedule(constants, steps)

    def initial(self, constants, noise):
        zero = jnp.zeros_like(constants["capacity"])
        return {
            "energy": 0.5 * constants["capacity"],
            "capacity": constants["capacity"],
            "price": self.price.initial(constants["price"], noise),
            "cycles": zero,
        }

    def observe(self, constants, now, state):
        spot = self._spot(constants, now, state)
        width = constants["spread"]
        features = [
            state["energy"] / constants["capacity"] - 0.5,
            (spot - now["mean"]) / width,
            (now["forward"] - now["mean"]) / width,
            (now["high"] - spot) / width,
            (spot - now["low"]) / width,
            now["left"],
        ]
        prices = self.price.observe(constants["price"], now["price"], state["price"])
        return jnp.concatenate([jnp.stack(features), prices])

    def step(self, constants, now, state, action, noise, smooth):
        c, power, scale = constants, constants["power"], constants["power"]
        # Half of the round-trip loss on charging, half on discharging; power is that at the grid.
        oneway = jnp.sqrt(c["efficiency"])
        wanted = power * action[0]
        out = smooth.minimum(
            smooth.positive_part(wanted, scale), state["energy"] * oneway, scale=scale
        )
        room = smooth.positive_part(state["capacity"] - state["energy"], scale)
        into = smooth.minimum(smooth.positive_part(-wanted, scale), room / oneway, scale=scale)
        energy = state["energy"] - out / oneway + into * oneway
        cycles = (out / oneway + into * oneway) / (2 * c["capacity"])
        worn = c["cycle_ageing"] * cycles * c["capacity"]
        capacity = state["capacity"] * (1 - c["calendar_ageing"]) - worn
        after = {
            # Energy that no longer fits into an aged battery is lost.
            "energy": smooth.minimum(energy, capacity, scale=scale),
            "capacity": capacity,
            "price": self.price.step(c["price"], now["price"], state["price"], noise),
            "cycles": state["cycles"] + cycles,
        }
        cash = (out - into) * self._spot(c, now, state)
        return after, {"cash": cash, "value": cash, "cycles": cycles}

    def terminal(self, constants, state, smooth):
        c = constants
        sold = state["energy"] * jnp.sqrt(c["efficiency"]) * c["last_price"]
        aged = (c["capacity"] - state["capacity"]) * c["replacement"]
        return {"value": sold - aged, "ageing_cost": aged}

    def state_scale(self, constants):
        c = constants
        one, noise = jnp.ones_like(c["capacity"]), jnp.zeros(self.initial_noise_size)
        prices = jax.tree.map(jnp.ones_like, self.price.initial(c["price"], noise))
        return {"energy": c["power"], "capacity": c["power"], "price": prices, "cycles": one}

    def _spot(self, constants, now, state):
        """The price in this hour."""
        return self.price.level(constants["price"], now["price"], state["price"])


def simulator() -> Battery:
    """A battery over a week of hours."""
    return Battery()


def inputs() -> Inputs:
    """A 10 MW / 20 MWh lithium battery and a price with a morning and an evening peak, in EUR."""
    hour = np.arange(HOURS)
    angle = 2 * np.pi * hour / 24
    daily = 70 - 18 * np.cos(angle - np.pi / 4) - 20 * np.cos(2 * angle - np.pi / 4)
    weekend = np.where(hour // 24 >= 5, 0.8, 1.0)
    names = [f"day {h // 24 + 1} {h % 24:02d}:00" for h in hour]
    return Inputs(
        price=SchwartzInputs(
            forward=snapo.Input(daily * weekend, "EUR/MWh", names),
            volatility=snapo.Input(0.10, "1/sqrt(hour)"),
            mean_reversion=snapo.Input(0.08, "1/hour"),
        ),
        power=snapo.Input(10.0, "MW"),
        capacity=snapo.Input(20.0, "MWh"),
        efficiency=snapo.Input(0.88, "round trip"),
        # 80 % of the capacity is left after 6000 full cycles; 2 % a year is lost without use.
        cycle_ageing=snapo.Input(0.2 / 6000, "capacity per cycle"),
        calendar_ageing=snapo.Input(0.02, "capacity per year"),
        replacement=snapo.Input(150_000.0, "EUR/MWh of capacity"),
    )


if __name__ == "__main__":
    print(snapo.solve(simulator(), inputs(), objective="value"))
