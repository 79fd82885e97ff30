"""The myopic rule of lost sales: the order that makes the period of its arrival cheapest.

Morton (1971); Zipkin, Operations Research 56 (2008), section 4. Of whole demand: the
probabilities of every stock in that period follow from the stock and the orders on their way; the
order is the smallest q with P(demand <= stock + q) >= p / (p + h).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Actions
from snapo.problem.inputs import Frozen
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT

from .order_up_to import HEAD, within


class Myopic(Policy):
    """Tables of the rule, for stocks 0 … n - 1 and orders 0 … m - 1.

    - `moves` [n, n]: probabilities of the stock left, by stock.
    - `met` [n, m]: P(demand <= left + q).
    - `ratio`: p / (p + h); `mean`: of demand, which observations are relative to.
    """

    moves: Frozen
    met: Frozen
    ratio: float
    mean: float
    lead_time: int
    action: Actions

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        unit, moves, met = observation[1], self.moves.array, self.met.array
        n = moves.shape[0]
        amounts = jnp.round(observation[HEAD:] * unit + self.mean)
        probabilities = (jnp.arange(n) == jnp.minimum(amounts[0], n - 1)).astype(observation.dtype)
        for i in range(self.lead_time):
            probabilities = probabilities @ moves.astype(observation.dtype)
            if i + 1 < self.lead_time:
                probabilities = _moved(probabilities, amounts[1 + i])
        reached = probabilities @ met.astype(observation.dtype)
        order = jnp.sum(reached < self.ratio).astype(observation.dtype)
        return within(self.action, order, smooth)


def myopic(
    probabilities: Float[np.ndarray, " demands"],
    mean: float,
    holding: float,
    shortage: float,
    lead_time: int,
    action: Actions,
) -> Myopic:
    """The rule for demand with these probabilities of 0, 1, …"""
    n = 2 * len(probabilities)
    padded = np.zeros(n)
    padded[: len(probabilities)] = probabilities
    stocks = np.arange(n)
    back = np.subtract.outer(stocks, stocks)  # [stock, left]: the demand between them
    moves = np.where(back >= 0, padded[np.maximum(back, 0)], 0.0)
    moves[:, 0] += 1 - moves.sum(1)
    upto = np.cumsum(padded)
    met = upto[np.minimum(np.add.outer(stocks, np.arange(len(probabilities))), n - 1)]
    tables = (Frozen(jnp.asarray(item, jnp.float32)) for item in (moves, met))
    return Myopic(*tables, shortage / (shortage + holding), mean, lead_time, action)  # pyright: ignore


def _moved(probabilities: Array, by: Array) -> Array:
    """Probabilities of a stock after an amount is added, capped at the end of the grid."""
    n = probabilities.shape[0]
    positions = jnp.minimum(jnp.arange(n) + by.astype(jnp.int32), n - 1)
    return jnp.zeros_like(probabilities).at[positions].add(probabilities)
