# An American put: the right to sell a share at the strike, once, on any of 50 dates in a year.
import jax.numpy as jnp

import snapo


class Put(snapo.Simulator):
    horizon, noise_size = 50, 1
    action = snapo.Stop()  # sell now, or wait

    def prepare(self, inputs):
        drift = (inputs["rate"] - inputs["volatility"] ** 2 / 2) / 50
        moves = {"drift": drift, "deviation": inputs["volatility"] / 50**0.5}
        year = jnp.arange(50.0) / 50
        steps = {"left": 1 - year, "discount": jnp.exp(-inputs["rate"] * year)}
        return snapo.Schedule(constants={**inputs, **moves}, steps=steps)

    def initial(self, constants, noise):
        return {"spot": constants["spot"], "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([5 * jnp.log(state["spot"] / constants["strike"]), now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        payoff = jnp.maximum(constants["strike"] - state["spot"], 0.0)
        spot = state["spot"] * jnp.exp(constants["drift"] + constants["deviation"] * noise[0])
        return {"spot": spot, "right": right}, {"cash": used * now["discount"] * payoff}

    def terminal(self, constants, state, smooth):  # after a year, if the right was not used
        payoff = jnp.maximum(constants["strike"] - state["spot"], 0.0)
        return {"cash": self.action.left(state["right"]) * jnp.exp(-constants["rate"]) * payoff}


inputs = {"spot": snapo.Input(36, "EUR"), "strike": snapo.Input(40, "EUR")}
inputs |= {"rate": snapo.Input(0.06, "1/year"), "volatility": snapo.Input(0.2)}
if __name__ == "__main__":
    print(snapo.solve(Put(), inputs))  # 4.478 by finite differences
