"""The best mix of assets at known prices: the maximum value of a unit of money within the limits.
It uses the log returns over cash of a step, which are Gaussian conditional on the market before the
step.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fund.schedule import FundTerms, Period
from ..market.assets.asset_class import by_kind
from ..market.dynamics import move, noise_size
from ..market.state import Market
from ..records.case import PensionModel


class MixBounds(NamedTuple):
    """Bounds [n] of the weights; `group` [n]: the group of each class, where a class without a
    group forms its own; bounds of the groups [k]; and `minimum`, `maximum` [b] of the swaps in each
    of b ranges of maturities, as shares of the assets; empty without swaps."""

    low: np.ndarray
    high: np.ndarray
    group: np.ndarray
    group_low: np.ndarray
    group_high: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray


def limits(case: PensionModel, leverage: float) -> MixBounds:
    """The limits of a fund. If the limits of swaps are hedge ratios, only the leverage limits a
    swap."""
    assets, overlay = case.assets, case.overlay
    low, high = np.array(assets.low, float), np.array(assets.high, float)
    group = np.full(len(low), -1)
    group_low, group_high = [], []
    for item in assets.groups:
        group[np.array(item.members)] = len(group_low)
        group_low.append(float(item.low))
        group_high.append(float(item.high))
    for alone in np.flatnonzero(group < 0):
        group[alone] = len(group_low)
        group_low.append(float(low[alone]))
        group_high.append(float(high[alone]))
    none = np.zeros(0)
    if overlay is None:
        minimum = maximum = none
    elif overlay.unit == "assets":
        minimum, maximum = np.array(overlay.low, float), np.array(overlay.high, float)
    else:
        maximum = np.full(case.buckets, leverage)
        minimum = -maximum
    return MixBounds(low, high, group, np.array(group_low), np.array(group_high), minimum, maximum)


def best_mix(
    limits: MixBounds, value: Float[Array, " n"], swaps: Float[Array, " b"]
) -> Float[Array, ""]:
    """The maximum of weights @ value + shares @ swaps over weights and shares. Each class belongs
    to one group, so a greedy method is exact: first the lower bounds are filled, then the best
    classes, within the bounds of the class, its group and the total.
    """
    best = jnp.sum(jnp.maximum(limits.minimum * swaps, limits.maximum * swaps))
    order = jnp.argsort(-value)
    member = jnp.asarray(limits.group)[:, None] == np.arange(len(limits.group_low))
    weight = jnp.asarray(limits.low)
    held = weight @ member
    room = jnp.asarray(limits.high - limits.low)
    # What groups must hold beyond their classes' lower bounds, from their own best classes.
    missing = jnp.maximum(limits.group_low - held, 0.0)
    for rank in range(len(limits.low)):
        position = order[rank]
        add = jnp.minimum(room[position], missing @ member[position])
        weight, room = weight.at[position].add(add), room.at[position].add(-add)
        missing = missing - add * member[position]
    free, group_room = 1 - jnp.sum(weight), limits.group_high - weight @ member
    for rank in range(len(limits.low)):
        position = order[rank]
        add = jnp.minimum(jnp.minimum(room[position], group_room @ member[position]), free)
        add = jnp.maximum(add, 0.0)
        weight, free = weight.at[position].add(add), free - add
        group_room = group_room - add * member[position]
    return weight @ value + best


class GaussianReturns(NamedTuple):
    """Log returns over cash, linear in the step's normals [Z].

    - `mean` [m], `load` [m, Z]: mean and loadings of the n classes and of money over cash (minus
      the log return of cash), so m = n + 1. For classes made of bonds this is to first order.
    - `bonds`, `bond_load`: the same for the q bonds of which classes and swaps are made; they are
      equal on all paths.
    - `shares`: for each kind, in the order of `by_kind`, the weights [k, q of the kind] of its
      bonds, and for the swaps if there are any; None if nothing is made of bonds.
    """

    mean: Float[Array, " m"]
    load: Float[Array, "m Z"]
    bonds: Float[Array, " q"]
    bond_load: Float[Array, "q Z"]
    shares: tuple[Array | None, ...]


# The axes over paths.
ACROSS = GaussianReturns(0, 0, None, None, 0)  # pyright: ignore


def gaussian_returns(
    case: PensionModel, terms: FundTerms, now: Period, market: Market
) -> GaussianReturns:
    """The returns of one step on one path."""

    def over_cash(noise):
        moved = move(case, terms.market, now.market, market, noise)
        bonds = [item.log for item in moved.beneath if item is not None]
        shares = tuple(None if entry is None else entry.share for entry in moved.beneath)
        logs = jnp.append(jnp.log(moved.gross) - moved.cash, -moved.cash)
        return logs, jnp.concatenate([jnp.zeros(0), *bonds]), shares

    calm = jnp.zeros(noise_size(case))
    mean, bonds, shares = over_cash(calm)
    load, bond_load = jax.jacfwd(lambda noise: over_cash(noise)[:2])(calm)
    return GaussianReturns(mean, load, bonds, bond_load, shares)


class Worth(NamedTuple):
    """Expected deflated values at the end of a step: of a unit invested in a class [n], of the gain
    of a swap per unit of notional [b], and of a unit of money paid at the end of the step."""

    classes: Array
    swaps: Array
    money: Array


def discounted_growth(
    case: PensionModel, returns: GaussianReturns, price: Float[Array, " Z"]
) -> Worth:
    """E[exp(-price @ noise - price^2 / 2) exp(return over cash)]."""
    exponent = _exponent(returns.mean, returns.load, price)
    bonds = jnp.expm1(_exponent(returns.bonds, returns.bond_load, price))
    classes, start, gains = jnp.exp(exponent[:-1]), 0, []
    for share in returns.shares:
        stop = start + (0 if share is None else share.shape[-1])
        gains.append(None if share is None else share @ bonds[start:stop])
        start = stop
    for (_, positions), gain in zip(by_kind(case), gains):
        if gain is not None:
            classes = classes.at[np.array(positions)].set(1 + gain)
    swaps = gains[-1] if case.buckets else jnp.zeros(0)
    return Worth(classes, swaps, jnp.exp(exponent[-1]))


def _exponent(mean: Array, load: Array, price: Array) -> Array:
    return mean + jnp.sum(load**2, axis=-1) / 2 - load @ price


def fair(returns: GaussianReturns) -> np.ndarray:
    """The smallest prices of risk [Z] at which no investment earns more than another, for the first
    step on the first path."""
    load = np.concatenate([returns.load[0, 0, :-1], returns.bond_load[0]])
    mean = np.concatenate([returns.mean[0, 0, :-1], returns.bonds[0]])
    return np.linalg.lstsq(load, mean + np.sum(load**2, axis=-1) / 2, rcond=None)[0]
