"""Many paths of a problem as an environment of Stable-Baselines3; all move in one compiled call.

When a path ends, Gymnasium's vectorised environments start a new one at the next step. Those of
Stable-Baselines3 start it in the same step, and return the last observation separately.
"""

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from snapo.gym.environments import GymDynamics

from .tasks import Task


class Paths(VecEnv):
    """`count` paths of the problem that an agent plays; actions between -1 and 1, or options."""

    def __init__(self, task: Task, count: int, seed: int, options: bool):
        self.task, self.options = task, options
        self.dynamics = GymDynamics(task.played or task.problem, task.endless)
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (self.dynamics.features,), np.float32)
        chosen = gymnasium.spaces.Box(-1.0, 1.0, (task.size,), np.float32)
        super().__init__(
            count, seen, gymnasium.spaces.Discrete(task.options) if options else chosen
        )
        self._random = np.random.default_rng(seed)
        self._first = jax.jit(jax.vmap(self.dynamics.first))
        self._step = jax.jit(self._moved)
        self._t = np.zeros(count, np.int32)

    def reset(self) -> np.ndarray:
        self._t[:] = 0
        self._state, seen = self._first(self._normals(self.dynamics.simulator.initial_noise_size))
        return np.array(seen)

    def step_async(self, actions: np.ndarray) -> None:
        self._chosen = raw_of(self.task, actions, self.options)

    def step_wait(self):
        sizes = self.dynamics.simulator
        noise = self._normals(sizes.initial_noise_size), self._normals(sizes.noise_size)
        found = self._step(self._t, self._state, self._chosen, noise)
        self._state, seen, rewards, over, late, last = found
        over, late, last = np.asarray(over), np.asarray(late), np.asarray(last)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over):
            infos[i] = {"terminal_observation": last[i], "TimeLimit.truncated": bool(late[i])}
        self._t = np.where(over, 0, self._t + 1).astype(np.int32)
        return np.array(seen), np.array(rewards, np.float32), over, infos

    def _moved(self, t, state, raw, noise):
        """All paths one step later; paths that have ended are at their first state again."""
        fresh, first = jax.vmap(self.dynamics.first)(noise[0])
        action = jnp.asarray(jax.vmap(self.task.decode)(raw), jnp.float32)
        moved = jax.vmap(self.dynamics.step)(t, state, action, noise[1])

        def either(new, old):
            return jnp.where(moved.over.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        state = jax.tree.map(either, fresh, moved.state)
        seen, reward = either(first, moved.observation), moved.reward / self.task.unit
        return state, seen, reward, moved.over, moved.late, moved.observation

    def _normals(self, size: int) -> np.ndarray:
        return self._random.standard_normal((self.num_envs, size), np.float32)

    def close(self) -> None:
        """Does nothing: no resource is open."""

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices=None, **kwargs: Any) -> list[Any]:
        return [getattr(self, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False] * self.num_envs


def raw_of(task: Task, actions: np.ndarray, options: bool) -> np.ndarray:
    """[N, size] numbers between -1 and 1, from an agent's actions."""
    given = np.asarray(actions)
    if options:
        given = 2.0 * given.reshape(-1, 1) / (task.options - 1) - 1
    return np.asarray(given, np.float32)
