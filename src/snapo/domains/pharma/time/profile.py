"""Profiles: a control over a unit's time, and its value anywhere."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snapo.case.given import CaseInput

from ..given import fixed, use


@dataclass(frozen=True, eq=False)
class Profile:
    """A control over a unit's time: N nodes, piecewise linear or piecewise constant.

    - `share`: "linear": [N] times of the nodes as shares of the unit's duration, 0 to 1, strictly
      rising from 0 to 1. "constant": [N + 1] edges of the pieces. One constant piece is a number.
    - `value`: index [N], in the quantity's unit.
    - `ramp`: most change per second, None without limit; open loop it is checked and reported.
    """

    kind: Literal["linear", "constant"]
    share: np.ndarray
    value: CaseInput
    ramp: float | None


def values_in(
    profile: Profile, value: Float[Array, " N"], piece: Int[Array, "..."], share
) -> Float[Array, "..."]:
    """The profile at shares of the duration that lie in its pieces number `piece`.

    The piece is an argument, not searched for: at a jump both sides can be requested, and the
    adjoint to the nodes is a gather.
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
    """The mean over the duration."""
    return jnp.sum(weights(profile) * value)


def flow_of(
    profile: Profile, inputs: Mapping[str, Any], duration, volume
) -> tuple[Profile, Float[Array, " N"]]:
    """The profile and its values as a flow in m3/s that adds up to `volume` over `duration`: the
    profile's values are its shape. All zero, nothing flows."""
    shape = use(inputs, profile.value)
    mean = mean_value(profile, shape)
    some = mean > 0
    return profile, jnp.where(some, volume / (duration * jnp.where(some, mean, 1.0)), 0.0) * shape
