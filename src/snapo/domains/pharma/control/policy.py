"""A recipe as a policy: an action for every step, with or without corrections by feedback."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.smooth import EXACT

EDGE = 1e-4  # actions at a bound begin this far inside, where a logit is finite


class Feedback(Policy):
    """action = sigmoid(table[step] + gain * network(observation)), in 0..1.

    The step is read from the first number observed, the share of all steps done, with hat
    functions, so that it is the same code in every engine. With `gain` 0 it is a fixed recipe:
    the network neither acts nor learns; with 1 both learn. It is one policy in both cases, so
    that nothing is compiled twice.
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
        """The same policy about another recipe, [T, size] logits."""
        return eqx.tree_at(lambda policy: policy.table, self, jnp.asarray(table, jnp.float32))

    def actions(self) -> np.ndarray:
        """[T, size] its decisions without feedback."""
        return np.asarray(jax.nn.sigmoid(self.table))

    def perturbed(self, spread: float, seed: int) -> "Feedback":
        """Another recipe to start from: logits moved by normal numbers of this deviation."""
        noise = np.random.default_rng(seed).normal(size=self.table.shape).astype(np.float32)
        return self.on(np.asarray(self.table) + spread * noise)
