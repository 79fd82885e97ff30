"""Policies made of others: one for each stage of a chain, or any module as a policy."""

import inspect
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..actions import Actions
from ..policy import Policy, as_observation, without_memory
from ..simulator import Interface
from ..smooth import EXACT, Smooth


class Stages(Policy):
    """A policy for each stage of a `Chain`, with the observation of that stage, not padded, and its
    action set.

    `Stages([MLP(hidden=(16, 16)), Constant(0.3)])` is a recipe: `solve` creates every policy for
    the actions and features of its stage. `Stages(policies, chain.interface(schedule))` is a
    policy that is made of existing ones.
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
                f"Stages: there are {len(self.policies)} policies for {len(interface.stages)} "
                "stages; a Chain needs one policy for each of its stages."
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


NEEDED = (
    "a policy of snapo, or an eqx.Module that is called as policy(observation, smooth), or as "
    "network(observation), such as eqx.nn.MLP"
)


class Plain(Policy):
    """A policy made of any `eqx.Module`; `solve` creates it.

    - `raw`: whether the module is called as `network(observation)`: its outputs are then unbounded,
      and are squashed into the action set. Otherwise it is called as `policy(observation, smooth)`,
      and its outputs are in the set.
    """

    module: Any
    raw: bool = eqx.field(static=True)
    action: Actions | None = None

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        if not self.raw:
            return self.module(observation, smooth)
        if self.action is None:
            raise ValueError("Plain: make the policy with for_problem(…), as solve does.")
        return self.action.squash(self.module(observation), smooth)

    def for_problem(self, interface: Interface, key) -> "Plain":
        """The policy with its set of actions.

        **Raises:** `ValueError` if sizes do not fit."""
        made = Plain(self.module, self.raw, interface.action)
        size, features = interface.action.size, interface.features
        name = type(self.module).__name__
        observed = jax.ShapeDtypeStruct((features,), jnp.float32)
        call = self.module if self.raw else lambda x: self.module(x, Smooth(0.1))
        try:
            shape = eqx.filter_eval_shape(call, observed).shape
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"solve: {name} does not take an observation of {features} numbers: {error}"
            ) from error
        if shape != (size,):
            raise ValueError(
                f"solve: {name} returns an array of shape {shape} for an observation of "
                f"{features} numbers; it must have the shape of the action, ({size},)."
            )
        return made


def as_policy(values: Any) -> Policy:
    """The policy itself, or a module as a policy.

    **Raises:** `TypeError` for anything else."""
    if isinstance(values, Policy):
        return values
    if not isinstance(values, eqx.Module) or not callable(values):
        raise TypeError(f"solve: policy is {values!r}; it must be {NEEDED}.")
    needed = [
        parameter
        for parameter in inspect.signature(values).parameters.values()
        if (parameter.default is parameter.empty or parameter.name == "smooth")
        and parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    if len(needed) not in (1, 2):
        raise TypeError(
            f"solve: {type(values).__name__} is called with {len(needed)} arguments; it must be "
            f"{NEEDED}."
        )
    return Plain(values, raw=len(needed) == 1)
