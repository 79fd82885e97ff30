"""A problem as a Gymnasium environment: one path at a time, for libraries that step by hand."""

from typing import Any, ClassVar

import jax
import numpy as np

from snapo.problem.problem import Problem

from .dynamics import Dynamics
from .installed import gymnasium
from .spaces import space_of


class Environment(gymnasium.Env):
    """The exact simulator of a problem as an environment that anyone's library can train in.

    - An observation is what a policy of snapo sees; a reward is a step's part of the objective,
      which must be a mean of sums. `info` has all outputs' part in it under "reward" alone.
    - Noise comes from the environment's generator: `reset(seed=…)` gives the same episode again.
    - `endless`: the horizon is a limit of time (`truncated`), not the end of the problem
      (`terminated`). An end of the simulator's own (`over`) terminates in both.
    """

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, problem: Problem, endless: bool = False):
        self.dynamics, self.endless = Dynamics(problem), endless
        self.render_mode = None
        seen = (self.dynamics.features,)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, seen, np.float32)
        self.action_space, self._read = space_of(problem.action)
        self._first, self._step = jax.jit(self.dynamics.first), jax.jit(self.dynamics.step)
        self._t, self._state = 0, None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observation of a new path, and no more information."""
        super().reset(seed=seed)
        noise = self._normals(self.dynamics.simulator.initial_noise_size)
        self._t = 0
        self._state, seen = self._first(noise)
        return np.asarray(seen), {}

    def step(self, action):
        """One decision: observation, reward, terminated, truncated, information."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("Environment: call reset before the first step.")
        noise = self._normals(self.dynamics.simulator.noise_size)
        chosen = self._read(np.asarray(action)[None])[0].astype(np.float32)
        moved = self._step(np.int32(self._t), self._state, chosen, noise)
        self._t, self._state = self._t + 1, moved.state
        late = self.endless and self._t >= self.dynamics.horizon
        ended = bool(moved.over) and not late
        return np.asarray(moved.observation), float(moved.reward), ended, late, {}

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal(size, np.float32)
