"""A reservoir: how much water to send through the turbines each week, with random prices and rain.

ONE path, in plain jax.numpy: no batch dimension, no random keys, no loop over time. An entry of
[inputs] in case.toml is passed as inputs["name"]. Try:

    snapo check . --simulator simulator:Reservoir
    snapo solve . --simulator simulator:Reservoir
"""

import jax.numpy as jnp

import snapo

WEEKS = 52


class Reservoir(snapo.Simulator):
    horizon = WEEKS  # the number of decisions
    noise_size = 2  # standard normals of one week: rain and price
    action = snapo.Box(0.0, 1.0)  # the share of the turbines' capacity

    # Once per call: the numbers that all paths share. `steps` has one entry per week.
    def prepare(self, inputs):
        steps = {
            "week": jnp.arange(WEEKS) / WEEKS,
            "forward": inputs["price"],
            "ahead": jnp.cumsum(inputs["price"][::-1])[::-1] / jnp.arange(WEEKS, 0, -1.0),
            "inflow": inputs["inflow"],
        }
        return snapo.Schedule(constants=inputs, steps=steps)

    # The state before the first decision: any tree of arrays. Noise moves the price's logarithm.
    def initial(self, constants, noise):
        return {"water": constants["water"], "log_price": jnp.zeros_like(constants["water"])}

    # What the policy sees: a few numbers of order one.
    def observe(self, constants, now, state):
        price = now["forward"] * jnp.exp(state["log_price"])
        return jnp.stack(
            [
                2 * now["week"] - 1,
                2 * state["water"] / constants["capacity"] - 1,
                price / now["ahead"] - 1,
                now["forward"] / now["ahead"] - 1,
            ]
        )

    # One week of one path. A limit is written with `smooth`, in the units of `scale`: training
    # uses the smooth limit, the reported value the exact one.
    def step(self, constants, now, state, action, noise, smooth):
        wet, swing = constants["rain_volatility"], constants["price_volatility"]
        inflow = now["inflow"] * jnp.exp(wet * noise[0] - wet**2 / 2)
        requested = constants["turbine"] * action[0]
        release = smooth.minimum(requested, state["water"], scale=constants["turbine"])
        full = constants["capacity"]
        left = state["water"] - release + inflow
        water = smooth.minimum(left, full, scale=constants["turbine"])  # the rest spills
        price = now["forward"] * jnp.exp(state["log_price"])
        cash = price * constants["energy"] * release
        log_price = 0.9 * state["log_price"] + swing * noise[1]
        outputs = {"cash": cash, "release": release, "spill": left - water}
        return {"water": water, "log_price": log_price}, outputs

    # At the end, the remaining water has a value per hm3.
    def terminal(self, constants, state, smooth):
        return {"cash": constants["end_value"] * state["water"]}

    # How far the limits are, for the certificate: negative where one is broken.
    def slack(self, constants, now, state, outputs):
        return {"not empty": state["water"], "not overfull": constants["capacity"] - state["water"]}
