"""The value of any rule on the same paths of the exact simulator, snapo's or an agent's."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import snapo.gym
from snapo.gym.environments import GymDynamics
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem

SEED = 20_260  # of the common paths: of no training
Rule = Callable[[np.ndarray], np.ndarray]  # from observations [N, features] to actions [N, size]


class Yardstick:
    """`paths` paths of a problem, in antithetic pairs."""

    def __init__(self, problem: Problem, paths: int, decode: Callable | None = None):
        self.dynamics, self.paths = GymDynamics(problem), paths
        self._decode = decode or (lambda raw: raw)
        self._first = jax.jit(jax.vmap(self.dynamics.first))
        self._step = jax.jit(jax.vmap(self._moved, in_axes=(None, 0, 0, 0)))

    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """The noise of the first state [N, k], and of all steps [T, N, m]."""
        simulator, half = self.dynamics.simulator, self.paths // 2
        random = np.random.default_rng(SEED)
        first = random.standard_normal((half, simulator.initial_noise_size), np.float32)
        size = (self.dynamics.horizon, half, simulator.noise_size)
        later = random.standard_normal(size, np.float32)
        return np.concatenate([first, -first]), np.concatenate([later, -later], 1)

    def totals(self, rule: Rule) -> np.ndarray:
        """[N] the rewards of every path."""
        first, noise = self.noise()
        state, seen = self._first(first)
        total = np.zeros(self.paths)
        for t in range(self.dynamics.horizon):
            chosen = np.asarray(rule(np.asarray(seen)), np.float32)
            state, seen, reward = self._step(np.int32(t), state, chosen, noise[t])
            total += np.asarray(reward, np.float64)
        return total

    def value(self, rule: "Rule | Policy") -> float:
        """The mean over all paths."""
        # The simulator takes decisions as they are, without the space of an environment.
        act = snapo.gym.Agent(rule, action=np.asarray) if isinstance(rule, Policy) else rule
        return float(self.totals(act).mean())

    def error(self, totals: np.ndarray) -> float:
        """The standard error of a mean of totals, by antithetic pairs."""
        pairs = totals.reshape(2, -1).mean(0)
        return float(pairs.std(ddof=1) / np.sqrt(pairs.size))

    def _moved(self, t, state, raw, noise):
        action = jnp.asarray(self._decode(raw), jnp.float32)
        moved = self.dynamics.step(t, state, action, noise)
        return moved.state, moved.observation, moved.reward
