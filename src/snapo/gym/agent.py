"""A policy as a plain function from an environment's observation to its action."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from snapo.problem.actions import Actions
from snapo.problem.code.version import of_policy, read_context
from snapo.problem.policies.memory import LastObservations, remembered
from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact

from .spaces import element, space_of, writer

AgentMap = Callable[[np.ndarray], Any]


class Agent:
    """Plays any environment: `agent(observation)` is the action for one observation, or the actions
    for several.

    - `features`: a function from the environment's observations [N, k] to the observations with
      which the policy was trained; by default they are the same.
    - `action`: a function from decisions [N, size] to N actions of the environment, or the
      environment's `action_space`, or the action set of the problem. By default it is the action
      set of the policy: an action is the number of the option for a `Choice`, a dictionary for a
      `Product`, and otherwise an array.

    An agent whose policy has a memory keeps the memory of every episode, [N, m] in `memory`; call
    `reset` when episodes begin. It must also be reset if the number of observations changes.
    """

    def __init__(
        self,
        policy: Policy,
        features: AgentMap | None = None,
        action: "AgentMap | Actions | Any" = None,
    ) -> None:
        self.policy, self._features = policy, features
        self.memory: np.ndarray | None = None
        self._given = action
        self._write = action if callable(action) else _writer(policy, action)

    def __call__(self, observation: np.ndarray) -> Any:
        """The action at an observation [k], or N actions at N observations [N, k]."""
        values = np.asarray(observation)
        observed = np.atleast_2d(values)
        observed = self._features(observed) if self._features else observed
        decided = np.asarray(self._decide(np.asarray(observed, np.float32)))
        actions = self._write(decided)
        return actions if values.ndim > 1 else element(actions, 0)

    def reset(self, began: np.ndarray | None = None) -> None:
        """Resets the memory of all episodes, or of the restarted episodes, for which `began` [N] is
        true."""
        if began is None or self.memory is None:
            self.memory = None
        else:
            self.memory = np.where(np.asarray(began, bool)[:, None], 0.0, self.memory)

    def on(self, space: Any) -> "Agent":
        """A copy with an empty memory. Its actions are those of `space`, unless the agent was made
        with an `action`."""
        return Agent(self.policy, self._features, space if self._given is None else self._given)

    def _decide(self, observed: np.ndarray) -> np.ndarray:
        """[N, size] decisions; updates the memory."""
        size = remembered(self.policy)
        memory = np.zeros((len(observed), size), np.float32) if self.memory is None else self.memory
        if size and len(memory) != len(observed):
            raise ValueError(
                f"Agent: it has a memory of {len(memory)} episodes, but got {len(observed)} "
                f"observations; call reset() when new episodes begin."
            )
        values = np.concatenate([observed, memory], 1)
        with read_context(of_policy(self.policy, values)):
            decided = np.asarray(_decided(self.policy, values))
        self.memory = decided[:, decided.shape[1] - size :] if size else None
        return decided[:, : decided.shape[1] - size]


@eqx.filter_jit
def _decided(policy: Policy, observed):
    return jax.vmap(lambda item: policy(item, Exact()))(observed)


def _writer(policy: Policy, values: Any) -> AgentMap:
    """The function from decisions to elements of a space or of an action set, by default of the
    policy's set."""
    action = values if isinstance(values, Actions) else set_of(policy)
    if values is not None and values is not action:
        return writer(values, action)
    if action is None:
        return lambda decided: decided
    return writer(space_of(action)[0], action)


def set_of(policy: Policy) -> Actions | None:
    """The action set of a policy; None if it has none."""
    if isinstance(policy, LastObservations):
        return set_of(policy.policy)
    action = getattr(policy, "action", None)
    return action if isinstance(action, Actions) else None
