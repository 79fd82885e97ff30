"""The problem that training sees: with wider starts, or decisions drawn at random.

Wider initial states, and decisions with a random share: both are wrappers of the user's simulator,
so that both engines support them, derivatives are pathwise, and values and validations, which use
the user's simulator, are not affected.

A decision that explores is (1 - share) times that of the policy plus share times a point drawn
anywhere in its set (`Actions.explore`). The share falls linearly to 0 over the steps in
which the temperature falls: the last quarter of the steps trains on the policy only.
"""

import math
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snapo.problem.noise import Counter, Draws, Stored
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import Around, Simulator
from snapo.problem.smooth import Smooth

from .settings import TrainingPlan


class Wide(Around):
    """A simulator whose initial normals are `spread` times as large."""

    spread: float = eqx.field(static=True)

    def initial(self, constants, noise):
        return self.inner.initial(constants, self.spread * noise)


class Exploring(Around):
    """A simulator that draws a share of every decision at random; the last normals of its noise are
    used for this.

    - `share`: the share at the temperature `hot`; it is 0 at `cold`, and in the exact simulator.
    """

    share: float = eqx.field(static=True)
    hot: float = eqx.field(static=True)
    cold: float = eqx.field(static=True)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.inner.noise_size + self.inner.action.exploration_size

    def step(self, constants, now, state, action, noise, smooth):
        drawn, more = noise[: self.inner.noise_size], noise[self.inner.noise_size :]
        if isinstance(smooth, Smooth):
            # The temperature falls geometrically, so that this is a straight line in the step.
            left = jnp.log(smooth.temperature / self.cold) / math.log(self.hot / self.cold)
            share = self.share * jnp.clip(left, 0.0, 1.0).astype(action.dtype)
            action = self.inner.action.explore(action, more, share)
        return self.inner.step(constants, now, state, action, drawn, smooth)


@dataclass(frozen=True, eq=False)
class MoreNoise(Scenarios):
    """Scenarios of training that were made for `simulator`, with the normals of `Exploring`."""

    inner: Scenarios
    simulator: Simulator
    seed: int

    def draws(self, paths: np.ndarray, simulator: Simulator) -> Draws:
        return self._longer(self.inner.draws(paths, self.simulator), 0)

    def batch(self, step: int, paths: int, simulator: Simulator) -> Draws:
        return self._longer(self.inner.batch(step, paths, self.simulator), step)

    def groups(self, paths: np.ndarray) -> np.ndarray:
        return self.inner.groups(paths)

    def available(self, requested: int) -> int:
        return self.inner.available(requested)

    def _longer(self, drawn: Draws, step: int) -> Draws:
        if isinstance(drawn, Counter):  # it counts as many as a simulator asks for
            return drawn
        steps, paths, _ = drawn.step_noise.shape
        random = np.random.default_rng([self.seed, step])
        more = random.standard_normal((steps, paths, self.simulator.action.exploration_size))
        noise = np.concatenate([np.asarray(drawn.step_noise), more], axis=2)
        return Stored(drawn.initial_noise, noise)  # pyright: ignore[reportArgumentType]


def refused(problem: Problem, training: TrainingPlan) -> tuple[str, str] | None:
    """The setting that this problem does not support, with the reason; None if it supports all."""
    simulator = problem.simulator
    if training.spread != 1 and not simulator.initial_noise_size:
        return "spread", (
            "the simulator starts every path in the same state. Set initial_noise_size to the "
            "number of normals that `initial` takes, and let the initial state depend on them: "
            'initial(self, constants, noise) gives {"x": constants["x"] + 0.1 * noise[0]}'
        )
    if training.exploration and not simulator.action.exploration_size:
        return "exploration", (
            f"a {type(simulator.action).__name__} explores by its temperature: set "
            "temperature_start"
        )
    return None


def perturbed_problem(problem: Problem, training: TrainingPlan) -> Problem:
    """The problem used in training: the problem itself if nothing is perturbed.

    **Raises:** `ValueError` for settings that this problem does not support.
    """
    if result := refused(problem, training):
        key, why = result
        raise ValueError(f"Training: {key} is {getattr(training, key)!r}, and {why}.")
    local = simulator = problem.simulator
    sources = problem.sources
    if training.spread != 1:
        simulator = Wide(simulator, training.spread)  # pyright: ignore[reportCallIssue]
    if training.exploration:
        hot, cold = training.temperature_start, training.temperature_end
        simulator = Exploring(simulator, training.exploration, hot, cold)  # pyright: ignore[reportCallIssue]
        sources = replace(sources, training=MoreNoise(sources.training, local, training.seed))
    if simulator is local:
        return problem
    return replace(problem, simulator=simulator, sources=sources).prepared(problem.schedule)
