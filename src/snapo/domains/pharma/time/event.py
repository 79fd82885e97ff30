"""When supersaturation first crosses zero, with the exact derivatives of that time."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..given import fixed
from .profile import Profile, values_in

ROUNDS, PARTS = 5, np.linspace(0.0, 1.0, 17)  # together a bracket of 1e-6


def saturation_share(
    excess: Callable[[Array], Array], profile: Profile, value: Float[Array, " N"]
) -> Float[Array, ""]:
    """The first share of the duration at which `excess(temperature)` is not above zero.

    `excess` is solubility less concentration; until then nothing happens, so that the
    concentration is the initial one. 0 where the start is saturated, 1 where it never crosses
    (no derivative in both), an edge where a jump of the profile crosses. In between: a bracket
    repeatedly divided into sixteen, without derivatives; then two Newton steps, which carry the
    first and second derivatives.
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
