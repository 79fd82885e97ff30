"""One path of the shop: it orders, sells, keeps what is left, and owes what it could not sell."""

import jax.numpy as jnp

import snapo


class Shop(snapo.Simulator):
    """State: pieces in stock, negative where customers wait. Action: the order, in mean demands.

    The demand of a day is mean x exp(volatility z - volatility^2 / 2). The shop pays for each
    piece it orders, each piece kept overnight, and each customer who waits. At the end the stock
    is sold, and any debt is bought, at cost. The best rule orders up to the quantile
    shortage / (shortage + holding) of the demand (Arrow, Harris and Marschak 1951; Veinott 1965).
    """

    horizon: int
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 4.0)

    def prepare(self, inputs):
        return snapo.Schedule(constants=inputs, steps={"left": jnp.arange(self.horizon, 0, -1.0)})

    def initial(self, constants, noise):
        return {"stock": constants["stock"]}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] / constants["demand"], now["left"] / self.horizon])

    def step(self, constants, now, state, action, noise, smooth):
        size, swing = constants["demand"], constants["volatility"]
        order = size * action[0]
        demand = size * jnp.exp(swing * noise[0] - swing**2 / 2)
        stock = state["stock"] + order - demand
        kept = smooth.positive_part(stock, scale=size)
        owed = smooth.positive_part(-stock, scale=size)
        profit = constants["price"] * demand - constants["cost"] * order
        profit = profit - constants["holding"] * kept - constants["shortage"] * owed
        return {"stock": stock}, {"profit": profit, "owed": owed}

    def terminal(self, constants, state, smooth):
        return {"profit": constants["cost"] * state["stock"]}
