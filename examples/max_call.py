# The right to buy the best of several shares, on one of nine dates in three years or at the end.
import jax.numpy as jnp

import snapo


class MaxCall(snapo.Simulator):
    horizon: int = 9
    noise_size: int = 2  # number of shares: one random number a step for each
    action: snapo.Stop = snapo.Stop()

    def prepare(self, inputs):
        year = jnp.arange(9.0) / 3
        drift = (inputs["rate"] - inputs["dividend"] - inputs["volatility"] ** 2 / 2) / 3
        moves = {"drift": drift, "deviation": inputs["volatility"] / 3**0.5}
        steps = {"left": 1 - year / 3, "discount": jnp.exp(-inputs["rate"] * year)}
        return snapo.Schedule({**inputs, **moves}, steps)

    def initial(self, constants, noise):
        spots = jnp.full(self.noise_size, constants["spot"])
        return {"spots": spots, "right": self.action.initial()}

    def observe(self, constants, now, state):
        ordered = jnp.sort(2 * jnp.log(state["spots"] / constants["strike"]))
        return jnp.concatenate([ordered, now["left"][None]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        payoff = jnp.maximum(state["spots"].max() - constants["strike"], 0.0)
        spots = state["spots"] * jnp.exp(constants["drift"] + constants["deviation"] * noise)
        return {"spots": spots, "right": right}, {"cash": used * now["discount"] * payoff}

    def terminal(self, constants, state, smooth):
        payoff = jnp.maximum(state["spots"].max() - constants["strike"], 0.0)
        return {"cash": self.action.left(state["right"]) * jnp.exp(-3 * constants["rate"]) * payoff}


inputs = {"spot": snapo.Input(100, "EUR"), "strike": snapo.Input(100, "EUR")}
inputs |= {"rate": snapo.Input(0.05, "1/year"), "dividend": snapo.Input(0.1, "1/year")}
inputs |= {"volatility": snapo.Input(0.2)}
if __name__ == "__main__":
    print(snapo.solve(MaxCall(noise_size=5), inputs))  # between 26.12 and 26.17
