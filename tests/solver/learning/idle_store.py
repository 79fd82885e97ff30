"""A store that neither buys nor sells: each alone earns nothing, so that no gradient leads away."""

import jax.numpy as jnp

import snapo


class IdleStore(snapo.Simulator):
    """Six cheap steps, then six dear ones; a decision is the shares bought and sold."""

    horizon: int = 12
    action: snapo.Box = snapo.Box(0.0, 1.0, 2)
    noise_size: int = 1

    def prepare(self, inputs):
        steps = jnp.arange(12)
        price = jnp.where(steps < 6, 1.0, inputs["high"])
        return snapo.Schedule(dict(inputs), {"price": price, "left": 1 - steps / 12})

    def initial(self, constants, noise):
        return {"stock": jnp.zeros(()), "noise": jnp.zeros(())}

    def observe(self, constants, now, state):
        price = now["price"] + 0.1 * state["noise"]
        return jnp.stack([2 * state["stock"] - 1, price - 2, now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        stock, price = state["stock"], now["price"] + 0.1 * state["noise"]
        sold = smooth.minimum(action[1], stock, scale=0.2)
        bought = smooth.minimum(action[0], 1 - stock + sold, scale=0.2)
        cash = price * (0.95 * sold - bought) - 0.02 * (stock - sold)
        return {"stock": stock - sold + bought, "noise": noise[0]}, {"cash": cash}


INPUTS = {"high": snapo.Input(3.0)}
