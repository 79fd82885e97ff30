"""Limits of trading: how far one step may move the weights towards those of the policy.

In this order: a class within its `band` of the wanted weight is not traded; of a class with a
`max_sale` no more is sold than that share of the holding per year (0: nothing); purchases shrink
together until no less cash is left than wanted; all trades shrink together to the turnover of a
step, where turnover is half the sum of all changes of weights, per year.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.smooth import Constraints

from .terms import TradingLimits

NEAR = 0.001  # of a weight, over which corners are rounded while training
NONE = 1e-12  # of the assets: fewer purchases than this are none


def dealt(
    cash: int, limits: TradingLimits, requested: Array, now: Array, smooth: Constraints
) -> Float[Array, " n"]:
    """The weights after trading, from those `now` [n] towards those `requested` [n]; both add up to
    1, and so do the result's."""
    is_cash = np.arange(len(now)) == cash
    move = jnp.where(is_cash, 0.0, requested - now)
    if limits.band is not None:
        far = smooth.indicator(jnp.abs(move) - limits.band, NEAR)
        move = jnp.where(limits.band > 0, far * move, move)
    if limits.max_sale is not None:
        limited = jnp.isfinite(limits.max_sale)
        maximum = jnp.where(limited, limits.max_sale, 0.0) * now
        move = jnp.where(limited, smooth.maximum(move, -maximum, NEAR), move)
    bought = jnp.sum(jnp.maximum(move, 0.0))
    free = now[cash] - requested[cash] - jnp.sum(jnp.minimum(move, 0.0))
    # While training, a class within its band is bought in traces, whose reciprocal has no bounds.
    some = bought > NONE
    room = jnp.where(some, bought, 1.0)
    paid = smooth.clip(free, 0.0, room, NEAR) / room
    move = jnp.where(some & (move > 0), move * paid, move)
    if limits.turnover is not None:
        maximum = limits.turnover
        turnover = (jnp.sum(jnp.abs(move)) + jnp.abs(jnp.sum(move))) / 2
        move = move * maximum / smooth.maximum(turnover, maximum, NEAR)
    return now + move - jnp.where(is_cash, jnp.sum(move), 0.0)
