"""A problem as an environment of Gymnasium, with one path or several, and the reward of an agent in
an environment."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from snapo.problem.code.version import followed
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.solver import statistics
from snapo.solver.adjoint import flat_weights

from .agent import Agent
from .spaces import batched, element, gymnasium, space_of

OutputsOf = dict[str, Float[Array, ""]]


@runtime_checkable
class Ends(Protocol):
    """A simulator whose episodes may end before the horizon."""

    def over(self, constants: PyTree, state: PyTree) -> Bool[Array, ""]:
        """Whether the episode has ended in this state."""
        ...


class NextState(NamedTuple):
    """The result of a step: the state, its observation, the reward and all outputs.

    - `ended`: whether the problem has ended, because of the simulator (`over`) or at the horizon.
    - `late`: whether a time limit truncates the episode while the problem would continue.
    - `outputs`: the outputs of the step, and at an end also the outputs of the terminal state; an
      output that only the terminal state has is 0 until then.
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

    The rewards of a path add up to its part of the objective; the rewards of the terminal state are
    paid in the step that ends the problem. With `endless` the horizon is a time limit, after which
    the problem would continue: if only the horizon ends the path, there are no terminal rewards.

    **Raises:** `ValueError` if the objective is not a mean of sums, and so is not a sum of rewards
    of steps.
    """

    def __init__(self, problem: Problem, endless: bool = False):
        self.simulator, objective = problem.simulator, problem.objective
        self.endless, self.kinds = endless, dict(self.simulator.totals())
        summed = all(self.kinds.get(name, "sum") == "sum" for name in objective.outputs)
        if not objective.linear or not summed:
            raise ValueError(
                "Environment: the objective must be a mean of outputs summed over the path; "
                f"{type(objective).__name__} of {', '.join(objective.outputs)} is not a sum of "
                f"rewards of steps."
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
        # A state may start as a whole number and continue as a float of the same meaning.
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
        """The outputs of the terminal state that are not outputs of a step."""

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
        """The observation. After the last step nothing is decided; the observation then uses the
        schedule of the last step."""
        now = at(self.schedule.steps, jnp.minimum(t, self.horizon - 1))
        return jnp.asarray(self.simulator.observe(self.schedule.constants, now, state), jnp.float32)

    def _worth(self, outputs: dict[str, Any]) -> Array:
        zero = jnp.zeros((), jnp.float32)
        return sum((w * outputs[k] for k, w in self.weights.items() if k in outputs), zero)

    def _told(self, outputs: OutputsOf, last: OutputsOf, ended: Array) -> OutputsOf:
        """The outputs of a step combined with the outputs of the terminal state, depending on the
        kind of total."""
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
    """The dynamics with its two compiled functions for one path."""

    dynamics: GymDynamics
    first: Any
    step: Any


_known: "WeakKeyDictionary[Problem, dict[Any, Compiled]]" = WeakKeyDictionary()


def compiled(problem: Problem, endless: bool) -> Compiled:
    """The compiled dynamics, which all environments of a problem share, because `play` makes an
    environment for every start."""
    made, key = _known.setdefault(problem, {}), (endless, problem.version)
    if key not in made:
        dynamics = GymDynamics(problem, endless)
        both = (followed(jax.jit(f), problem.version) for f in (dynamics.first, dynamics.step))
        made[key] = Compiled(dynamics, *both)
    return made[key]


class Environment(gymnasium.Env):
    """The exact simulator of a problem as an environment, for training with any library.

    - Observations are the same as for snapo's policies. A reward is a step's part of the objective,
      which must be a mean of sums. `info` holds all outputs of the step by name, as numbers; the
      outputs of the terminal state are in the step that ends the problem.
    - Noise comes from the environment's generator: `reset(seed=…)` gives the same episode again.
    - `endless`: whether the horizon is a time limit (`truncated`), and not the end of the problem
      (`terminated`); the outputs of the terminal state are then not paid at the horizon. If the
      simulator ends the episode (`over`), it is terminated in both cases, even at the last step.
    - `decisions`: the action set of the problem.
    """

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, problem: Problem, endless: bool = False):
        self.dynamics, self._first, self._step = compiled(problem, endless)
        self.decisions, self.endless, self.render_mode = problem.action, endless, None
        observed = (self.dynamics.features,)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, observed, np.float32)
        self.action_space, self._read = space_of(problem.action)
        self._only_last = self.dynamics.only_last()
        self._t, self._state = 0, None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observation of a new path, and an empty `info`."""
        super().reset(seed=seed)
        noise = self._normals(self.dynamics.simulator.initial_noise_size)
        self._t = 0
        self._state, observed = self._first(noise)
        return np.asarray(observed), {}

    def step(self, action):
        """One decision: observation, reward, terminated, truncated, outputs."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("Environment: call reset before the first step.")
        noise = self._normals(self.dynamics.simulator.noise_size)
        selected = self._read(batched(action))[0].astype(np.float32)
        moved = self._step(np.int32(self._t), self._state, selected, noise)
        self._t, self._state = self._t + 1, moved.state
        ended, late = bool(moved.ended), bool(moved.late)
        but = () if ended else self._only_last
        info = {name: float(x) for name, x in moved.outputs.items() if name not in but}
        return np.asarray(moved.observation), float(moved.reward), ended, late, info

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal(size, np.float32)


class Played(NamedTuple):
    """The mean reward of an episode with its standard error, and the rewards and steps [starts] of
    all episodes."""

    mean: float
    standard_error: float
    rewards: np.ndarray
    steps: np.ndarray

    def __str__(self) -> str:
        half = statistics.plus_minus(self.standard_error, degrees=len(self.rewards) - 1)
        return f"{self.mean:.4g} {half} (95 %) over {len(self.rewards):,} starts"


def play(
    agent: Agent | Policy | Callable[[np.ndarray], np.ndarray],
    environment: "str | Callable[[], Any]",
    starts: int | Sequence[int] = 2000,
) -> Played:
    """Plays one episode from every start, all episodes in parallel.

    **Arguments:**

    - `agent`: an `Agent`, a policy, or any function from observations [N, k] to N actions. The
      actions of a policy are converted to the environment's space (see `Agent`); the memory of an
      agent is reset.
    - `environment`: a name such as "Pendulum-v1", or a function that makes an environment.
    - `starts`: seeds of `environment.reset(seed=…)`, or a number n for the seeds 0 … n - 1. They
      are the same for every agent, so that agents are compared on common starts.
    """
    seeds = range(starts) if isinstance(starts, int) else starts
    if not len(seeds):
        raise ValueError("play: specify at least one start.")
    worlds = [made(environment) for _ in seeds]
    act = _for_world(agent, worlds[0])
    firsts = [item.reset(seed=int(seed))[0] for item, seed in zip(worlds, seeds)]
    observed = np.stack([np.asarray(first, np.float32) for first in firsts])
    rewards, steps = np.zeros(len(worlds)), np.zeros(len(worlds), int)
    going = list(range(len(worlds)))
    while going:
        actions = act(observed)  # of all: one compiled shape
        left = []
        for i in going:
            observed[i], reward, ended, late, _ = worlds[i].step(element(actions, i))
            rewards[i] += reward
            steps[i] += 1
            if not (ended or late):
                left.append(i)
        going = left
    for world in worlds:
        world.close()
    average = statistics.mean(rewards, np.arange(rewards.size))
    return Played(float(np.mean(rewards)), average.standard_error, rewards, steps)


def _for_world(agent: Any, world: Any) -> Callable[[np.ndarray], Any]:
    """The agent, or an agent for the policy, with the actions of the environment and an empty
    memory."""
    if not isinstance(agent, Agent | Policy):
        return agent
    act = Agent(agent) if isinstance(agent, Policy) else agent
    local = isinstance(world.unwrapped, Environment)
    return act.on(world.unwrapped.decisions if local else world.action_space)


def made(environment: "str | Callable[[], Any]"):
    """The environment of this name, or the environment that the function creates."""
    if isinstance(environment, str):
        return gymnasium.make(environment, disable_env_checker=True)
    return environment()


class VectorEnvironment(gymnasium.vector.VectorEnv):
    """`num_envs` paths of the exact simulator in parallel (see `Environment`).

    A path that has ended restarts at its next step, whose action is not used and whose reward is 0
    (Gymnasium's `AutoresetMode.NEXT_STEP`). `info` has the numbers [N] of every output and, under
    its name with a leading underscore, the paths [N] for which the numbers are valid.
    """

    def __init__(self, problem: Problem, num_envs: int, endless: bool = False):
        self.dynamics, self.endless = GymDynamics(problem, endless), endless
        self.num_envs = num_envs
        mode = gymnasium.vector.AutoresetMode.NEXT_STEP
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.render_mode = None
        observed = (self.dynamics.features,)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, observed, np.float32)
        self.single_action_space, self._read = space_of(problem.action)
        batch = gymnasium.vector.utils.batch_space
        self.observation_space = batch(self.single_observation_space, num_envs)
        self.action_space = batch(self.single_action_space, num_envs)
        self._only_last = self.dynamics.only_last()
        self._first = followed(jax.jit(jax.vmap(self.dynamics.first)), problem.version)
        self._step = followed(jax.jit(self._moved), problem.version)
        self._t = np.zeros(num_envs, np.int32)
        self._done = np.zeros(num_envs, bool)
        self._state = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observations [N, features] of new paths; one seed determines all of them."""
        super().reset(seed=seed)
        self._t[:], self._done[:] = 0, False
        self._state, observed = self._first(
            self._normals(self.dynamics.simulator.initial_noise_size)
        )
        return np.asarray(observed), {}

    def step(self, actions):
        """One decision for every path: [N, features], [N] rewards, terminated, truncated, info."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("VectorEnvironment: call reset before a step.")
        size = self.dynamics.simulator
        noise = self._normals(size.initial_noise_size), self._normals(size.noise_size)
        selected = self._read(actions).astype(np.float32)
        repeated = self._done.copy()
        self._state, moved = self._step(self._t, self._state, selected, noise, repeated)
        self._t = np.where(repeated, 0, self._t + 1).astype(np.int32)
        ended, late = np.asarray(moved.ended), np.asarray(moved.late)
        self._done = ended | late
        info = {name: np.asarray(value) for name, value in moved.outputs.items()}
        counts = {f"_{name}": ended if name in self._only_last else ~repeated for name in info}
        rewards = np.asarray(moved.reward, np.float64)
        return np.asarray(moved.observation), rewards, ended, late, info | counts

    def _moved(self, t, state, actions, noise, repeated):
        """Moves all paths. Paths that are `repeated` restart at their initial state, and their
        outputs do not count."""
        fresh, first = jax.vmap(self.dynamics.first)(noise[0])
        moved = jax.vmap(self.dynamics.step)(t, state, actions, noise[1])

        def either(new, old):
            return jnp.where(repeated.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        state = jax.tree.map(either, fresh, moved.state)
        reward, outputs, *flags = jax.tree.map(
            lambda old: either(jnp.zeros((), old.dtype), old), tuple(moved[2:])
        )
        return state, NextState((), either(first, moved.observation), reward, outputs, *flags)

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal((self.num_envs, size), np.float32)
