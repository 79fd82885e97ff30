"""One policy for each stage of a chain."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp

from ..actions import Actions
from ..policy import Policy, as_observation, without_memory
from ..simulator import Interface
from ..smooth import EXACT


class Stages(Policy):
    """A policy for each stage of a `Chain`; each sees its own stage's observation, not padded, and
    decides in its own stage's set.

    `Stages([MLP(hidden=(16, 16)), Constant(0.3)])` is a recipe: `solve` gives every policy the
    actions and features of its stage. `Stages(policies, chain.interface(schedule))` is made at
    once, of policies that are made.
    """

    policies: tuple[Policy, ...]
    action: Actions | None
    features: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, policies: Sequence[Policy], interface: Interface | None = None):
        self.policies, self.action, self.features = tuple(policies), None, ()
        for policy in self.policies:
            without_memory(policy, "Stages")
        if interface is None:
            return
        if len(interface.stages) != len(self.policies):
            raise ValueError(
                f"Stages: there are {len(self.policies)} policies and {len(interface.stages)} "
                "stages; a Chain takes one policy for each of its stages."
            )
        self.action = interface.action
        self.features = tuple(stage.features for stage in interface.stages)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        if self.action is None:
            raise ValueError(
                "Stages: this is a recipe; make the policy with "
                "for_problem(chain.interface(schedule), key), as solve does."
            )
        # The chain's observation ends with one number per stage, which is 1 in that stage.
        here = observation[-len(self.policies) :] > 0.5
        # Components that a stage does not read lie in the middle of the chain's set.
        action = middle = self.action.squash(jnp.zeros(self.action.size, observation.dtype), smooth)
        for i, (policy, features) in enumerate(zip(self.policies, self.features)):
            # In other stages the policy sees zeros, so that their numbers reach neither its value
            # nor its derivative.
            observed = jnp.where(here[i], observation[:features], 0.0)
            local = policy(observed, smooth)
            selected = jnp.concatenate([local, middle[local.shape[0] :].astype(local.dtype)])
            action = jnp.where(here[i], selected, action)
        return action

    def for_problem(self, interface: Interface, key) -> "Stages":
        checked = Stages(self.policies, interface)
        keys = jax.random.split(key, len(self.policies))
        made = [
            policy.for_problem(stage, item)
            for policy, stage, item in zip(checked.policies, interface.stages, keys)
        ]
        return Stages(made, interface)
