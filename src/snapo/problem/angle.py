"""Angles: the state counts turns, and rewards and observations repeat with every turn.

A state that jumps from pi to -pi has no derivative there. So the state has the unwrapped angle;
costs and observations are periodic functions of it.
"""

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

TURN = 2 * np.pi


def wrap_angle(angle: ArrayLike) -> Float[Array, " *shape"]:
    """The angle [...] in radians without full turns, from -pi to below pi, up to rounding.

    For a difference of two angles it is the shorter rotation: `wrap_angle(angle - target) ** 2` is
    a cost. Its first derivative is 1 and its second is 0, even where it jumps from pi to -pi; the
    square is continuous there. Angles between -pi and pi are unchanged to the last digit.

    >>> [round(float(snapo.wrap_angle(np.pi * x)), 4) for x in (0.5, 1.5, -6.25)]
    [1.5708, -1.5708, -0.7854]
    """
    values = jnp.asarray(angle)
    return values - TURN * jnp.floor(values / TURN + 0.5)


def angle_features(angle: ArrayLike) -> Float[Array, " *shape 2"]:
    """The features (cosine, sine) [..., 2] of an angle [...] in radians, which have no jump.

    >>> snapo.angle_features(np.float32(0.0)).tolist()
    [1.0, 0.0]
    """
    values = jnp.asarray(angle)
    return jnp.stack([jnp.cos(values), jnp.sin(values)], -1)
