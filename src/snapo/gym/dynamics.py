"""One step of a problem at a time, for an environment: state, observation, reward, end."""

from typing import Any, NamedTuple, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from snapo.problem.code.version import followed
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import flat_weights

OutputsOf = dict[str, Float[Array, ""]]


@runtime_checkable
class Ends(Protocol):
    """A simulator whose episodes may end before the horizon."""

    def over(self, constants: PyTree, state: PyTree) -> Bool[Array, ""]:
        """Whether the episode has ended in this state."""
        ...


class NextState(NamedTuple):
    """After a step: the state, its observation, the reward and all outputs.

    - `ended`: the problem has ended: by the simulator (`over`) or at the horizon.
    - `late`: a limit of time cuts the episode off, and the problem would go on.
    - `outputs`: of the step, and at an end those of the terminal state as well; a name that only
      the terminal state has is 0 before.
    """

    state: PyTree
    observation: Float[Array, " features"]
    reward: Float[Array, ""]
    outputs: OutputsOf
    ended: Bool[Array, ""]
    late: Bool[Array, ""]

    @property
    def over(self) -> Bool[Array, ""]:
        """Whether the episode is over, for either reason."""
        return self.ended | self.late


class GymDynamics:
    """The exact simulator of a problem in single precision, step by step.

    The rewards of a path add up to its share of the objective; those of the terminal state come
    with the step that ends the problem. With `endless` the horizon is a limit of time, after which
    the problem would go on: a state at which only the horizon ends the path has no terminal
    rewards.

    **Raises:** `ValueError` where the objective is no mean of sums, which has no reward of a step.
    """

    def __init__(self, problem: Problem, endless: bool = False):
        self.simulator, objective = problem.simulator, problem.objective
        self.endless, self.kinds = endless, dict(self.simulator.totals())
        summed = all(self.kinds.get(name, "sum") == "sum" for name in objective.outputs)
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
        """An initial state and its observation."""
        state = jax.tree.map(jnp.asarray, self.simulator.initial(self.schedule.constants, noise))
        return state, self._seen(jnp.zeros((), jnp.int32), state)

    def step(self, t: Array, state: PyTree, action: Array, noise: Array) -> NextState:
        """Step `t` of one path."""
        constants, now = self.schedule.constants, at(self.schedule.steps, t)
        after, outputs = self.simulator.step(constants, now, state, action, noise, Exact())
        # A state may start as a whole number and go on as a float of the same meaning.
        after = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)
        last = self.simulator.terminal(constants, after, Exact())
        due = t + 1 >= self.horizon
        ended = jnp.zeros((), bool) if self.endless else due
        if isinstance(self.simulator, Ends):
            ended = ended | self.simulator.over(constants, after)
        reward = self._worth(outputs) + jnp.where(ended, self._worth(last), 0.0)
        combined = self._told(outputs, last, ended)
        return NextState(after, self._seen(t + 1, after), reward, combined, ended, due & ~ended)

    def only_last(self) -> tuple[str, ...]:
        """The outputs that only the terminal state has, none of a step."""

        def both():
            constants, now = self.schedule.constants, at(self.schedule.steps, 0)
            simulator = self.simulator
            state = simulator.initial(constants, jnp.zeros(simulator.initial_noise_size))
            action, noise = jnp.zeros(simulator.action.size), jnp.zeros(simulator.noise_size)
            _, outputs = simulator.step(constants, now, state, action, noise, Exact())
            return outputs, simulator.terminal(constants, state, Exact())

        outputs, last = jax.eval_shape(both)
        return tuple(name for name in last if name not in outputs)

    def _seen(self, t: Array, state: PyTree) -> Array:
        """The observation; after the last step nothing is decided, and the last schedule holds."""
        now = at(self.schedule.steps, jnp.minimum(t, self.horizon - 1))
        return jnp.asarray(self.simulator.observe(self.schedule.constants, now, state), jnp.float32)

    def _worth(self, outputs: dict[str, Any]) -> Array:
        zero = jnp.zeros((), jnp.float32)
        return sum((w * outputs[k] for k, w in self.weights.items() if k in outputs), zero)

    def _told(self, outputs: OutputsOf, last: OutputsOf, ended: Array) -> OutputsOf:
        """The outputs of a step joined with those of the terminal state, by the kind of total."""
        combined = {name: jnp.asarray(value, jnp.float32) for name, value in outputs.items()}
        for name, value in last.items():
            before, kind = combined.get(name, jnp.zeros(())), self.kinds.get(name, "sum")
            if kind == "sum" or name not in combined:
                joined = before + value
            else:
                joined = jnp.maximum(before, value) if kind == "max" else value
            combined[name] = jnp.where(ended, joined, before)
        return combined


class Compiled(NamedTuple):
    """The dynamics with its two compiled functions, of one path."""

    dynamics: GymDynamics
    first: Any
    step: Any


_known: "WeakKeyDictionary[Problem, dict[Any, Compiled]]" = WeakKeyDictionary()


def compiled(problem: Problem, endless: bool) -> Compiled:
    """Compiled once for all environments of a problem: `play` makes one for every start."""
    made, key = _known.setdefault(problem, {}), (endless, problem.version)
    if key not in made:
        dynamics = GymDynamics(problem, endless)
        both = (followed(jax.jit(f), problem.version) for f in (dynamics.first, dynamics.step))
        made[key] = Compiled(dynamics, *both)
    return made[key]
