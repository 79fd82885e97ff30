# A reservoir: how much water to send through the turbines each week, with random prices and rain.
import jax.numpy as jnp

import snapo


class Reservoir(snapo.Simulator):
    horizon, noise_size = 52, 2  # weeks; random numbers a week: rain, price
    action = snapo.Box(0.0, 1.0)  # the share of the turbines' capacity

    def prepare(self, inputs):  # the numbers that all paths share
        return snapo.Schedule(constants=inputs, steps={"week": jnp.arange(52.0)})

    def initial(self, constants, noise):
        return {"water": constants["water"], "price": constants["price"]}

    def observe(self, constants, now, state):  # what the policy sees, scaled to order one
        return jnp.stack([now["week"] / 26 - 1, state["water"] / 50 - 1, state["price"] / 50 - 1])

    def step(self, constants, now, state, action, noise, smooth):  # one week of one path
        release = smooth.minimum(10 * action[0], state["water"], scale=10.0)
        rain = constants["rain"] * jnp.exp(0.5 * noise[0] - 0.125)
        water = smooth.minimum(state["water"] - release + rain, 100.0, scale=10.0)  # excess spills
        price = state["price"] ** 0.8 * constants["price"] ** 0.2 * jnp.exp(0.2 * noise[1])
        return {"water": water, "price": price}, {"cash": state["price"] * release}


inputs = {"water": snapo.Input(60, "hm3"), "rain": snapo.Input(4, "hm3"), "price": snapo.Input(50)}
if __name__ == "__main__":
    print(snapo.solve(Reservoir(), inputs, objective="cash"))
