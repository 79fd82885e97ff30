"""Modules of the user's own, or of Equinox, as policies."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..actions import Actions
from ..policy import Policy, as_observation
from ..simulator import Interface
from ..smooth import EXACT, Smooth

NEEDED = (
    "a policy of snapo's, or an eqx.Module that is called as policy(observation, smooth), or as "
    "network(observation), such as eqx.nn.MLP"
)


class Plain(Policy):
    """An `eqx.Module` where a policy goes; `solve` makes it of whatever module it is given.

    - `raw`: whether it is called as `network(observation)`: its numbers are unbounded, and are
      squashed into the action set. Otherwise it is called as `policy(observation, smooth)`, and
      what it gives lies in the set.
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
        """Itself with its set of actions. **Raises:** `ValueError` where sizes do not fit."""
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
                f"solve: {name} gives numbers of shape {shape} for an observation of {features}; "
                f"the action has the shape ({size},)."
            )
        return made


def as_policy(values: Any) -> Policy:
    """The policy that was given, or a module as one. **Raises:** `TypeError` for all else."""
    if isinstance(values, Policy):
        return values
    if not isinstance(values, eqx.Module) or not callable(values):
        raise TypeError(f"solve: policy is {values!r}; allowed is {NEEDED}.")
    needed = [
        parameter
        for parameter in inspect.signature(values).parameters.values()
        if (parameter.default is parameter.empty or parameter.name == "smooth")
        and parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    if len(needed) not in (1, 2):
        raise TypeError(
            f"solve: {type(values).__name__} is called with {len(needed)} arguments; allowed is "
            f"{NEEDED}."
        )
    return Plain(values, raw=len(needed) == 1)
