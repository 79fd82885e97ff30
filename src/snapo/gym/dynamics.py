"""One step of a problem at a time, for an environment: state, observation, reward, end."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import flat_weights


@runtime_checkable
class Ends(Protocol):
    """A simulator whose episodes may end before the horizon."""

    def over(self, constants: PyTree, state: PyTree) -> Bool[Array, ""]:
        """Whether the episode has ended in this state."""
        ...


class Moved(NamedTuple):
    """After a step: the state, its observation, the reward, and whether the episode is over."""

    state: PyTree
    observation: Float[Array, " features"]
    reward: Float[Array, ""]
    over: Bool[Array, ""]


class Dynamics:
    """The exact simulator of a problem in single precision, step by step.

    The rewards of a path add up to its share of the objective; those of the last state come with
    the last step.

    **Raises:** `ValueError` where the objective is no mean of sums, which has no reward of a step.
    """

    def __init__(self, problem: Problem):
        self.simulator, objective = problem.simulator, problem.objective
        kinds = self.simulator.totals()
        summed = all(kinds.get(name, "sum") == "sum" for name in objective.outputs)
        if not objective.linear or not summed:
            raise ValueError(
                "Environment: the objective must be a mean of outputs summed over the path; "
                f"{type(objective).__name__} of {', '.join(objective.outputs)} has no reward of a "
                "step."
            )
        self.weights = {k: float(w[0]) for k, w in flat_weights(objective, 1).items()}
        self.schedule = jax.tree.map(jnp.asarray, problem.schedule)
        self.features, self.horizon = problem.features, self.simulator.horizon

    def first(self, noise: Float[Array, " initial_noise"]) -> tuple[PyTree, Array]:
        """A first state and its observation."""
        state = jax.tree.map(jnp.asarray, self.simulator.initial(self.schedule.constants, noise))
        return state, self._seen(jnp.zeros((), jnp.int32), state)

    def step(self, t: Array, state: PyTree, action: Array, noise: Array) -> Moved:
        """Step `t` of one path."""
        constants, now = self.schedule.constants, at(self.schedule.steps, t)
        after, outputs = self.simulator.step(constants, now, state, action, noise, Exact())
        # A state may start as a whole number and go on as a float of the same meaning.
        after = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)
        last = self.simulator.terminal(constants, after, Exact())
        done = t + 1 >= self.horizon
        over = done
        if isinstance(self.simulator, Ends):
            over = over | self.simulator.over(constants, after)
        reward = self._worth(outputs) + jnp.where(over, self._worth(last), 0.0)
        return Moved(after, self._seen(t + 1, after), reward, over)

    def _seen(self, t: Array, state: PyTree) -> Array:
        """The observation; after the last step nothing is decided, and the last schedule holds."""
        now = at(self.schedule.steps, jnp.minimum(t, self.horizon - 1))
        return jnp.asarray(self.simulator.observe(self.schedule.constants, now, state), jnp.float32)

    def _worth(self, outputs: dict[str, Any]) -> Array:
        zero = jnp.zeros((), jnp.float32)
        return sum((w * outputs[k] for k, w in self.weights.items() if k in outputs), zero)
