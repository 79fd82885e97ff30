"""Many paths of a problem as one vectorised environment: all move in one compiled call."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.code.version import followed
from snapo.problem.problem import Problem

from .dynamics import GymDynamics, NextState
from .installed import gymnasium
from .spaces import space_of


class VectorEnvironment(gymnasium.vector.VectorEnv):
    """`num_envs` paths of the exact simulator side by side (see `Environment`).

    A path that has ended starts anew at its next step, whose action is not used and whose reward
    is 0 (Gymnasium's `AutoresetMode.NEXT_STEP`). `info` holds [N] of every output and, under its
    name after an underscore, for which paths it counts.
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
        """The first observations [N, features] of new paths; one seed makes all of them."""
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
        summary = {name: np.asarray(value) for name, value in moved.outputs.items()}
        counts = {f"_{name}": ended if name in self._only_last else ~repeated for name in summary}
        rewards = np.asarray(moved.reward, np.float64)
        return np.asarray(moved.observation), rewards, ended, late, summary | counts

    def _moved(self, t, state, actions, noise, repeated):
        """All paths moved; those to start `repeated` at their first state, where nothing counts."""
        fresh, first = jax.vmap(self.dynamics.first)(noise[0])
        moved = jax.vmap(self.dynamics.step)(t, state, actions, noise[1])

        def either(new, old):
            return jnp.where(repeated.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        state = jax.tree.map(either, fresh, moved.state)
        reward, outputs, *endpoints = jax.tree.map(
            lambda old: either(jnp.zeros((), old.dtype), old), tuple(moved[2:])
        )
        return state, NextState((), either(first, moved.observation), reward, outputs, *endpoints)

    def _normals(self, size: int) -> np.ndarray:
        return self.np_random.standard_normal((self.num_envs, size), np.float32)
