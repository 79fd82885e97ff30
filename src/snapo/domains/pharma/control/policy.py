"""A recipe as a policy: an action for every step, with or without corrections by feedback. Also the
readings of sensors with a dead time.

An analyser at the end of a sample line, or a slow method, shows a past state. The true readings at
the last decisions are stored, the latest first. The reading one dead time ago is interpolated
linearly between two of them; before the unit's start it is the first reading. The sensor's error is
added when the sensor is read.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.smooth import EXACT

from .records import Measurement


def history_length(sensors: Sequence[Measurement], interval: float) -> int:
    """The number of true readings required, `interval` s apart; 0 without any dead time.

    One more than needed for the dead time, since a unit's duration may vary from batch to batch.
    """
    longest = max((sensor.delay for sensor in sensors), default=0.0)
    return math.ceil(longest / interval * (1 + 1e-9)) + 2 if longest else 0


def initial_history(values, length: int) -> Float[Array, "M L"]:
    """The stored readings at a unit's start: its first readings [M], repeated `length` times."""
    return jnp.tile(jnp.asarray(values)[:, None], (1, length))


def shifted(values, past) -> Float[Array, "M L"]:
    """The stored readings after the readings `values` [M] were added as the latest."""
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


EDGE = 1e-4  # actions at a bound begin this far inside, where a logit is finite


class Feedback(Policy):
    """action = sigmoid(table[step] + gain * network(observation)), in 0..1.

    The step follows from the first number observed, the share of all steps that are done, by hat
    functions, so that every engine runs the same code. With `gain` 0 it is a fixed recipe: the
    network neither acts nor learns; with 1 both learn. It is one policy in both cases, so that
    nothing is compiled twice.
    """

    table: Float[Array, "T size"]
    network: Network
    gain: Frozen

    def __init__(self, recipe: np.ndarray, features: int, *, key, hidden=(32, 32)):
        """`recipe`: [T, size] actions in 0..1; the network starts with corrections near 0."""
        inside = np.clip(recipe, EDGE, 1 - EDGE)
        self.table = jnp.asarray(np.log(inside / (1 - inside)), jnp.float32)
        self.network = Network((features, *hidden, recipe.shape[1]), key=key)
        self.gain = Frozen(np.zeros((), np.float32))

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        steps = self.table.shape[0]
        distance = jnp.abs(observation[0] * steps - jnp.arange(steps))
        weights = jnp.maximum(1 - distance, 0).astype(observation.dtype)
        planned = weights @ self.table.astype(observation.dtype)
        gain = jnp.asarray(self.gain).astype(observation.dtype)
        return jax.nn.sigmoid(planned + gain * self.network(observation))

    def closed(self) -> "Feedback":
        """The same recipe with feedback."""
        return eqx.tree_at(lambda policy: policy.gain, self, Frozen(np.ones((), np.float32)))

    def on(self, table: np.ndarray) -> "Feedback":
        """The same policy around another recipe, [T, size] logits."""
        return eqx.tree_at(lambda policy: policy.table, self, jnp.asarray(table, jnp.float32))

    def actions(self) -> np.ndarray:
        """The decisions without feedback, [T, size]."""
        return np.asarray(jax.nn.sigmoid(self.table))

    def perturbed(self, spread: float, seed: int) -> "Feedback":
        """Another recipe to start from: the logits plus normal random numbers of this standard
        deviation."""
        noise = np.random.default_rng(seed).normal(size=self.table.shape).astype(np.float32)
        return self.on(np.asarray(self.table) + spread * noise)
