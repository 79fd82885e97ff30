"""A policy as a plain function from an environment's observation to its action."""

from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact

Map = Callable[[np.ndarray], np.ndarray]


class Agent:
    """Plays any environment: `agent(observation)` is the action, for one or for many.

    - `features`: from the environment's observations [N, k] to those that the policy was trained
      on; `action`: from decisions [N, size] to the environment's actions. By default the same.
    """

    def __init__(
        self, policy: Policy, features: Map | None = None, action: Map | None = None
    ) -> None:
        self.policy = policy
        self._features, self._action = features, action

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The action [m] at an observation [k]; or [N, m] at [N, k]."""
        given = np.asarray(observation)
        seen = np.atleast_2d(given)
        seen = self._features(seen) if self._features else seen
        decided = np.asarray(_decided(self.policy, np.asarray(seen, np.float32)))
        decided = self._action(decided) if self._action else decided
        return decided if given.ndim > 1 else decided[0]


@eqx.filter_jit
def _decided(policy: Policy, seen):
    return jax.vmap(lambda each: policy(each, Exact()))(seen)
