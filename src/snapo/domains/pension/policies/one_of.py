"""Several rules as one policy: a program compiled for one of them serves all."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT


class OneOf(Policy):
    """Decides as the rule at `place` does; only this one is tuned.

    All are computed, which costs a fund little beside its own step; the place is a number that
    the program reads, not a part of it.
    """

    rules: tuple[Policy, ...]
    place: Frozen

    def __init__(self, rules: Sequence[Policy], place: int):
        self.rules, self.place = tuple(rules), Frozen(np.array(float(place)))

    @property
    def rule(self) -> Policy:
        """The one that decides."""
        return self.rules[round(float(self.place.array))]

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        place = jax.lax.stop_gradient(jnp.asarray(self.place.array, observation.dtype))
        actions = [rule(observation, smooth) for rule in self.rules]
        action = actions[0]
        for i, each in enumerate(actions[1:], 1):
            action = jnp.where(jnp.abs(place - i) < 0.5, each, action)
        return action
