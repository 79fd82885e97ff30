"""Profiles: a control over a unit's time, and its value at any time. Also the time at which
supersaturation first crosses zero under a temperature profile, with its exact derivatives.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import Array, Float, Int, jax, jnp

from ..given import fixed, use


@dataclass(frozen=True, eq=False)
class Profile:
    """A control over a unit's time: N nodes, piecewise linear or piecewise constant.

    - `share`: "linear": [N] times of the nodes as shares of the unit's duration, 0 to 1, strictly
      rising from 0 to 1. "constant": [N + 1] edges of the pieces. One constant piece is a number.
    - `value`: index [N], in the quantity's unit.
    - `ramp`: the largest change per second, None without limit; in open loop it is checked and
      reported.
    """

    kind: Literal["linear", "constant"]
    share: np.ndarray
    value: CaseInput
    ramp: float | None


def values_in(
    profile: Profile, value: Float[Array, " N"], piece: Int[Array, "..."], share
) -> Float[Array, "..."]:
    """The profile at shares of the duration, each in the piece with the number in `piece`. The
    piece is an argument and is not searched for, so both sides of a jump can be requested, and the
    adjoint with respect to the nodes is a gather.
    """
    if profile.kind == "constant":
        return jnp.broadcast_to(value[piece], jnp.shape(share))
    start = fixed(profile.share)[piece]
    slope = jnp.diff(value) / np.diff(profile.share)
    return value[piece] + slope[piece] * (share - start)


def values_at(profile: Profile, value: Float[Array, " N"], share) -> Float[Array, "..."]:
    """The profile at any shares of the duration; at a jump the later value."""
    inner = fixed(profile.share[1:-1])
    return values_in(profile, value, jnp.searchsorted(inner, share, side="right"), share)


def weights(profile: Profile) -> Float[np.ndarray, " N"]:
    """Shares with which the nodes enter the mean over the duration."""
    width = np.diff(profile.share)
    if profile.kind == "constant":
        return width
    return (np.append(0.0, width) + np.append(width, 0.0)) / 2


def mean_value(profile: Profile, value: Float[Array, " N"]) -> Float[Array, ""]:
    """The mean of the profile over the duration."""
    return jnp.sum(weights(profile) * value)


def flow_of(
    profile: Profile, inputs: Mapping[str, Any], duration, volume
) -> tuple[Profile, Float[Array, " N"]]:
    """The profile and its values as a flow in m3/s that adds up to `volume` over `duration`; the
    profile supplies only the shape of the flow. If all values are zero, nothing flows."""
    shape = use(inputs, profile.value)
    mean = mean_value(profile, shape)
    some = mean > 0
    return profile, jnp.where(some, volume / (duration * jnp.where(some, mean, 1.0)), 0.0) * shape


ROUNDS, PARTS = 5, np.linspace(0.0, 1.0, 17)  # together a bracket of 1e-6


def saturation_share(
    excess: Callable[[Array], Array], profile: Profile, value: Float[Array, " N"]
) -> Float[Array, ""]:
    """The first share of the duration at which `excess(temperature)` is not above zero.

    `excess` is solubility minus concentration; before that share nothing crystallises, so that the
    concentration is the initial one. The result is 0 if the start is saturated, 1 if `excess`
    stays above zero (both without a derivative), and an edge if `excess` crosses zero at a jump of
    the profile. Otherwise a bracket is repeatedly divided into sixteen parts, without derivatives;
    two Newton steps follow, which have the first and second derivatives.
    """
    if profile.kind == "constant":
        crossed = excess(value) <= 0
        first = jnp.argmax(crossed)
        return jnp.where(jnp.any(crossed), fixed(profile.share)[first], 1.0)
    level = jax.lax.stop_gradient(excess(value))
    crossed = level <= 0
    piece = jnp.clip(jnp.argmax(crossed) - 1, 0, len(value) - 2)
    inside = jnp.any(crossed) & ~crossed[0]
    at_rest = jax.lax.stop_gradient(value)

    def distance(share, value):
        return excess(values_in(profile, value, piece, share))

    nodes = fixed(profile.share)
    left, right = nodes[piece], nodes[piece + 1]
    for _ in range(ROUNDS):
        points = left + (right - left) * fixed(PARTS)
        below = jax.lax.stop_gradient(distance(points, at_rest)) <= 0
        # The last point lies below by choice of the bracket, even if round-off suggests otherwise.
        first = jnp.clip(jnp.argmax(below), 1, len(PARTS) - 1)
        first = jnp.where(jnp.any(below), first, len(PARTS) - 1)
        left, right = points[first - 1], points[first]
    share = jax.lax.stop_gradient((left + right) / 2)
    for _ in range(2):
        gap, slope = jax.jvp(lambda s: distance(s, value), (share,), (jnp.ones_like(share),))
        share = share - gap / jnp.where(inside & (slope != 0), slope, 1.0)
    outside = jnp.where(crossed[0], 0.0, 1.0)
    return jnp.where(inside, share, outside)
