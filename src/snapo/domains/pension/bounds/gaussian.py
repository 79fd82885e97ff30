"""Log returns over cash of a step as Gaussian: means and loads, given the market before it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fund.schedule import Period, Terms
from ..market.dynamics import move, noise_size
from ..market.state import Market
from ..records.case import PensionCase


class Returns(NamedTuple):
    """`mean` [m] and `load` [m, Z] on the step's normals of n classes over cash, of b swaps, and
    of money over cash (minus its log return): m = n + b + 1. Linear in the normals."""

    mean: Float[Array, " m"]
    load: Float[Array, "m Z"]


def gaussian_returns(case: PensionCase, terms: Terms, now: Period, market: Market) -> Returns:
    """Those of one step on one path."""

    def over_cash(noise):
        moved = move(case, terms.market, now.market, market, noise)
        parts = [jnp.log(moved.gross) - moved.cash]
        parts += [] if moved.swaps is None else [moved.swaps]
        return jnp.concatenate([*parts, -moved.cash[None]])

    calm = jnp.zeros(noise_size(case))
    return Returns(over_cash(calm), jax.jacfwd(over_cash)(calm))


class Worth(NamedTuple):
    """Deflated expectations of a unit after a step: of the classes [n], of the gain of the swaps
    [b], and of money paid at its end."""

    classes: Array
    swaps: Array
    money: Array


def worth(case: PensionCase, returns: Returns, price: Float[Array, " Z"]) -> Worth:
    """E[exp(-price @ noise - price^2 / 2) exp(return over cash)]."""
    exponent = returns.mean + jnp.sum(returns.load**2, axis=-1) / 2 - returns.load @ price
    n = len(case.assets.classes)
    grown = jnp.exp(exponent)
    return Worth(grown[:n], jnp.expm1(exponent[n:-1]), grown[-1])
