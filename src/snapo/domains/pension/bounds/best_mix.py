"""The best mix at given prices: the maximum value of a unit of money within the limits."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import PensionModel


class MixBounds(NamedTuple):
    """Bounds [n] of the weights; `group` [n] the group of each class, groups [k] with bounds (a
    class without a group forms one); of the swaps: `minimum`, `maximum` [b] shares."""

    low: np.ndarray
    high: np.ndarray
    group: np.ndarray
    group_low: np.ndarray
    group_high: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray


def limits(case: PensionModel, leverage: float) -> MixBounds:
    """Those of a fund; of swaps that are sized by payments, what leverage leaves to each."""
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
    """max over weights and shares of weights @ value + shares @ swaps.

    Each class belongs to one group, so a greedy fill is exact: first the lower bounds, then the
    best classes within the room of the class, its group and the total.
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
