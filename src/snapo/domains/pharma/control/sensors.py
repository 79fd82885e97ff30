"""What a sensor shows: the state as it was a dead time ago.

An analyser at the end of a sample line, or a slow method, shows the past. The true readings at
the last decisions are kept, the latest first, and the one a dead time ago is read between two of
them in a straight line; before the unit's start it is the first one. The sensor's error is added
when it is read.
"""

import math
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .records import Measurement


def history_length(sensors: Sequence[Measurement], interval: float) -> int:
    """How many true readings must be known, `interval` s apart; 0 without any dead time.

    One more than needed for the dead time, since a unit's duration may vary from batch to batch.
    """
    longest = max((sensor.delay for sensor in sensors), default=0.0)
    return math.ceil(longest / interval * (1 + 1e-9)) + 2 if longest else 0


def initial_history(values, length: int) -> Float[Array, "M L"]:
    """The past at a unit's start: its first readings [M]."""
    return jnp.tile(jnp.asarray(values)[:, None], (1, length))


def shifted(values, past) -> Float[Array, "M L"]:
    """The past, once the readings `values` [M] are the latest."""
    if not past.shape[1]:
        return past
    return jnp.concatenate([jnp.asarray(values)[:, None], past[:, :-1]], 1)


def reading(value, past: Float[Array, " L"], sensor: Measurement, interval) -> Float[Array, ""]:
    """The state that a sensor shows without error, from its `past` in steps of `interval` s."""
    if not sensor.delay:
        return value
    steps = jnp.arange(past.shape[0])
    ago = jnp.minimum(sensor.delay / interval, past.shape[0] - 1.0)
    return jnp.maximum(1 - jnp.abs(ago - steps), 0.0).astype(past.dtype) @ past
