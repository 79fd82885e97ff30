"""Transfers between stores: before demand, to balance stocks, or after it, to meet shortages.

In a pool every place offers its stock above one level and requests its shortage below another,
which is not higher. The smaller of the two sums is moved; it is divided in proportion to offers,
and in proportion to requests. Pools act one after the other, the cheapest first. With two places,
or with one cost for all places, this is the cheapest way to move the amount.

- **After demand** a place offers the remaining stock above the amount that it holds back, and
  requests its unmet demand. If places hold nothing back, this is complete pooling (Krishnan and
  Rao, 1965; Tagaras, 1989).
- **Before demand** the level is that of balance, at which all places of the pool are the same
  number of standard deviations above their mean demand; a place offers its stock above balance plus
  a band, and requests its shortage below balance minus the band. The policy may shift the balance
  of each place.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.smooth import Exact

from .records import Pool, SupplyNetwork


class Transferred(NamedTuple):
    """Stocks [n] after the transfers, amounts sent and received [n], and the cost."""

    stock: jax.Array
    sent: jax.Array
    received: jax.Array
    cost: jax.Array


def move_before(network: SupplyNetwork, constants, stock, band, shift, smooth) -> Transferred:
    """Balances the pools that act before demand; `band`, `shift` [m] of `network.moving(True)`."""
    members = np.array(network.moving(True), int)
    band, shift = (jnp.zeros_like(stock).at[members].set(item) for item in (band, shift))

    def levels(pool: Pool, stock):
        inside = _mask(pool.sites, stock)
        unit, mean = inside * constants["unit"], constants["mean"]
        above = jnp.sum(inside * (stock - mean))
        balance = mean + above * unit / jnp.sum(unit) + shift
        if network.integer and isinstance(smooth, Exact):
            balance = _rounded(balance)
        # No more can be sent than there is.
        return smooth.positive_part(balance, constants["corner"]) + band, balance - band

    return _moved(network, constants, stock, levels, True, smooth)


def move_after(network: SupplyNetwork, constants, stock, held, smooth) -> Transferred:
    """Sends goods to places where demand exceeded stock; `held` [m] of `network.moving(False)`."""
    members = np.array(network.moving(False), int)
    held = jnp.zeros_like(stock).at[members].set(held)
    return _moved(
        network, constants, stock, lambda *_: (held, jnp.zeros_like(stock)), False, smooth
    )


def _moved(network: SupplyNetwork, constants, stock, levels, before: bool, smooth) -> Transferred:
    sent, received = jnp.zeros_like(stock), jnp.zeros_like(stock)
    cost = jnp.zeros((), stock.dtype)
    for k in network.cheapest_first:
        pool = network.pools[k]
        if pool.before != before:
            continue
        now = stock - sent + received
        upper, lower = levels(pool, now)
        corner = constants["corner"]
        # Corners are differentiated upwards in stock, as demand in whole units needs it.
        spare = _mask(pool.givers, stock) * smooth.positive_part(now - upper, corner)
        lack = smooth.positive_part(now - lower, corner) - (now - lower)
        lack = _mask(pool.takers, stock) * lack
        moved = smooth.minimum(spare.sum(), lack.sum(), corner.sum())
        values, taken = (shared(network, moved, item, smooth) for item in (spare, lack))
        sent, received = sent + values, received + taken
        cost = cost + constants["transshipment"][k] * moved
    return Transferred(stock - sent + received, sent, received, cost)


def shared(network: SupplyNetwork, total, parts, smooth):
    """[n] `total`, divided in proportion to `parts` [n]; it is at most their sum."""
    some = jnp.sum(parts) > 0
    result = parts * jnp.where(some, total, 0.0) / jnp.where(some, jnp.sum(parts), 1.0)
    return in_pieces(network, result, smooth)


def in_pieces(network: SupplyNetwork, amounts, smooth):
    """[n] amounts rounded to whole numbers of the same sum, each changed by less than 1; training
    leaves them unchanged."""
    if not network.integer or not isinstance(smooth, Exact):
        return amounts
    upto = jnp.concatenate([jnp.zeros_like(amounts[:1]), jnp.cumsum(amounts)])
    return jnp.diff(_rounded(upto))


def _rounded(amounts):
    """The nearest whole numbers, with the derivative of the amounts themselves."""
    return amounts + jax.lax.stop_gradient(jnp.floor(amounts + 0.5) - amounts)


def _mask(sites: Sequence[int], like):
    result = np.zeros(like.shape)
    result[list(sites)] = 1.0
    return jnp.asarray(result, like.dtype)
