"""A problem as a Gymnasium environment: one path at a time, for libraries that step by hand."""

from typing import Any, ClassVar

import numpy as np

from snapo.problem.problem import Problem

from .dynamics import compiled
from .installed import gymnasium
from .spaces import batched, space_of


class Environment(gymnasium.Env):
    """The exact simulator of a problem as an environment that anyone's library can train in.

    - An observation is what a policy of snapo sees; a reward is a step's part of the objective,
      which must be a mean of sums. `info` holds all outputs of the step by name, numbers; those
      of the last state are in the step that ends the problem.
    - Noise comes from the environment's generator: `reset(seed=…)` gives the same episode again.
    - `endless`: the horizon is a limit of time (`truncated`), not the end of the problem
      (`terminated`), and outputs of the last state are not paid there. An end of the simulator's
      own (`over`) terminates in both, also at the last step.
    - `decisions`: the set that its actions are elements of.
    """

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, problem: Problem, endless: bool = False):
        self.dynamics, self._first, self._step = compiled(problem, endless)
        self.decisions, self.endless, self.render_mode = problem.action, endless, None
        seen = (self.dynamics.features,)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, seen, np.float32)
        self.action_space, self._read = space_of(problem.action)
        self._only_last = self.dynamics.only_last()
        self._t, self._state = 0, None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observation of a new path, and no more information."""
        super().reset(seed=seed)
        noise = self._normals(self.dynamics.simulator.initial_noise_size)
        self._t = 0
        self._state, seen = self._first(noise)
        return np.asarray(seen), {}

    def step(self, action):
        """One decision: observation, reward, terminated, truncated, outputs."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("Environment: call reset before the first step.")
        noise = self._normals(self.dynamics.simulator.noise_size)
        chosen = self._read(batched(action))[0].astype(np.float32)
        moved = self._step(np.int32(self._t), self._state, chosen, noise)
        self._t, self._state = self._t + 1, moved.state
        ended, late = bool(moved.ended), bool(moved.late)
        but = () if ended else self._only_last
        told = {name: float(x) for name, x in moved.outputs.items() if name not in but}
        return np.asarray(moved.observation), float(moved.reward), ended, late, told

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal(size, np.float32)
