"""Many paths of a problem as one vectorised environment: all move in one compiled call."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.problem import Problem

from .dynamics import Dynamics
from .installed import gymnasium
from .spaces import space_of


class VectorEnvironment(gymnasium.vector.VectorEnv):
    """`num_envs` paths of the exact simulator side by side (see `Environment`).

    A path that has ended starts anew at its next step, whose action is not used and whose reward
    is 0 (Gymnasium's `AutoresetMode.NEXT_STEP`).
    """

    def __init__(self, problem: Problem, num_envs: int, endless: bool = False):
        self.dynamics, self.endless, self.num_envs = Dynamics(problem), endless, num_envs
        mode = gymnasium.vector.AutoresetMode.NEXT_STEP
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.render_mode = None
        seen = (self.dynamics.features,)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, seen, np.float32)
        self.single_action_space, self._read = space_of(problem.action)
        batch = gymnasium.vector.utils.batch_space
        self.observation_space = batch(self.single_observation_space, num_envs)
        self.action_space = batch(self.single_action_space, num_envs)
        self._first = jax.jit(jax.vmap(self.dynamics.first))
        self._step = jax.jit(self._moved)
        self._t = np.zeros(num_envs, np.int32)
        self._done = np.zeros(num_envs, bool)
        self._state = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observations [N, features] of new paths; one seed makes all of them."""
        super().reset(seed=seed)
        self._t[:], self._done[:] = 0, False
        self._state, seen = self._first(self._normals(self.dynamics.simulator.initial_noise_size))
        return np.asarray(seen), {}

    def step(self, actions):
        """One decision for every path: [N, features], [N] rewards, terminated, truncated."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("VectorEnvironment: call reset before a step.")
        size = self.dynamics.simulator
        noise = self._normals(size.initial_noise_size), self._normals(size.noise_size)
        chosen = self._read(np.asarray(actions)).astype(np.float32)
        again = self._done.copy()
        found = self._step(self._t, self._state, chosen, noise, again)
        self._state, seen, rewards, over = found
        self._t = np.where(again, 0, self._t + 1).astype(np.int32)
        late = self.endless & (self._t >= self.dynamics.horizon)
        ended = np.asarray(over) & ~late
        self._done = ended | late
        return np.asarray(seen), np.asarray(rewards, np.float64), ended, late, {}

    def _moved(self, t, state, actions, noise, again):
        """All paths moved; those to start `again` at their first state."""
        fresh, first = jax.vmap(self.dynamics.first)(noise[0])
        moved = jax.vmap(self.dynamics.step)(t, state, actions, noise[1])

        def either(new, old):
            return jnp.where(again.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        state = jax.tree.map(either, fresh, moved.state)
        seen, rewards = either(first, moved.observation), jnp.where(again, 0.0, moved.reward)
        return state, seen, rewards, moved.over & ~again

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal((self.num_envs, size), np.float32)
