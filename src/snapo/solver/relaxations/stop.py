"""An upper bound for any stopping problem, without input from its user.

The inner problem is optimal stopping with perfect foresight and any number of rights (Rogers 2002;
Haugh and Kogan 2004; for several rights Schoenmakers, *Finance and Stochastics* 16, 2012). Each
decision is charged the innovation in its earnings and in a fitted continuation value. Their
expectations come from nested draws of one step: points of low discrepancy, shifted at random for
every path and step, so that they are unbiased and their noise is small (Andersen and Broadie 2004
draw at random, over many steps).
"""

from collections.abc import Callable
from hashlib import sha256
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array

from snapo.engine import Rollout
from snapo.engine.base import cast
from snapo.problem.actions import Stop
from snapo.problem.code.version import followed
from snapo.problem.noise import Counter, Draws, noise_of_steps
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.problem.simulator import at

from .value import NotStopping, better, decisions, fit, states_of, value

FIT, INNER = 16384, 64  # paths of the regression, and nested draws of every step
FITTING = 258  # stream of the paths of the regression
SHIFTS = 259  # separates the keys of the shifts of nested draws from those of the noise
TOGETHER = 32  # paths whose nested draws are in memory at once
NOT_DRAWN = "its scenarios are supplied, so that no nested paths can be drawn from a state"


class StopRelaxation:
    """See `snapo.Relaxation`. `paths` is the number of paths of the regression, `inner` the number
    of nested draws at every step of a path.

    **Raises:** `NotStopping` if the problem has no such bound, with the reason.
    """

    terms = 1
    description = "the innovations of a fitted value of the remaining rights to stop"

    def __init__(self, problem: Problem, paths: int = FIT, inner: int = INNER):
        from scipy.stats import qmc  # late: it takes a second to load

        self.decisions, self.horizon = decisions(problem), problem.simulator.horizon
        if not isinstance(problem.sources.training, Pseudo):
            raise NotStopping(NOT_DRAWN)
        self.size = problem.simulator.noise_size
        self.points = qmc.Sobol(max(self.size, 1), scramble=False).random(inner)
        source = Pseudo(problem.sources.training.seed, stream=stream(EVALUATE, FITTING))
        with jax.enable_x64(True):
            self.schedule = cast(problem.schedule, np.float64)
            self.fitted_value = fit(self.decisions, source, paths, self.schedule)
            self._surprises, self._end = self._compiled()
            self._better = jax.jit(jax.vmap(better))
        self._kept: list[tuple[Rollout, np.ndarray, np.ndarray]] = []

    def best(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        earnings, innovations = self._table(rollout, draws)
        with jax.enable_x64(True):
            ahead = self._end(rollout.state)
            for earned, innovation in zip(earnings[::-1], innovations[::-1]):
                # `better` adds the continuation value to the earnings of a decision minus its
                # penalty.
                ahead = self._better(earned - scale[0] * innovation, ahead)
            return np.asarray(ahead)[:, -1]

    def charged(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        innovations = self._table(rollout, draws)[1]
        left = self.decisions.left(states_of(rollout))
        result = np.zeros(left.shape[1])
        for innovation, before, after in zip(innovations, left, left[1:]):
            result += innovation[np.arange(left.shape[1]), before, before - after]
        return scale[0] * result

    def _table(self, rollout: Rollout, draws: Draws) -> tuple[np.ndarray, np.ndarray]:
        """[T, N, rights + 1, 2] twice: every decision's earnings, and the innovation in them and in
        the continuation value."""
        for available, earnings, innovations in self._kept:
            if available is rollout:
                return earnings, innovations
        states, results = rollout.record["state"], []
        with jax.enable_x64(True):
            noise = noise_of_steps(draws, self.horizon, self.size)
            shifts = _shifts(draws, self.horizon, self.points.shape[1])
            for t in range(self.horizon):
                values = np.int32(t), at(states, t), noise[t], shifts[t]
                results.append([np.asarray(x) for x in self._surprises(*values)])
        earnings, innovations = map(np.stack, zip(*results))
        self._kept.append((rollout, earnings, innovations))
        return earnings, innovations

    def _compiled(self) -> tuple[Callable, Callable]:
        """The computations of every step on all paths, and the earnings of the terminal states."""
        problem, schedule, resolved, last = (
            self.decisions,
            self.schedule,
            self.fitted_value,
            self.horizon,
        )

        def value_at(t, state):
            """The value at step t, or of the terminal state."""
            return jax.lax.cond(
                t == last,
                lambda: problem.end(schedule, state),
                lambda: value(problem, schedule, resolved, jnp.minimum(t, last - 1), state),
            )

        def decided(t, state, noise):
            """[rights + 1, 2] of every decision, twice: its earnings, and these with the
            continuation value."""
            after, earnings = problem.step(schedule, t, state, noise)
            ahead = value_at(t + 1, after)
            left = jnp.stack([ahead, jnp.append(ahead[:1], ahead[:-1])], axis=1)
            return earnings, earnings + left

        def one(t, state, noise, shift):
            # Numbers that are never 0 or 1, whose normals are infinite.
            uniform = jnp.clip((self.points + shift) % 1.0, 1e-12, 1 - 1e-12)
            nested = ndtri(uniform)[:, : self.size]
            mean = jax.vmap(lambda z: decided(t, state, z)[1])(nested).mean(0)
            earnings, result = decided(t, state, noise)
            return earnings, result - mean

        def all_paths(t, states, noise, shifts):
            values = states, noise, shifts
            return jax.lax.map(lambda x: one(t, *x), values, batch_size=TOGETHER)

        both = jax.jit(all_paths), jax.jit(jax.vmap(lambda state: problem.end(schedule, state)))
        version = problem.problem.version
        return followed(both[0], version), followed(both[1], version)


def _shifts(draws: Draws, horizon: int, size: int) -> Array:
    """[T, N, size] a shift of the nested draws for every path and step. Paths of other numbers,
    seeds and uses have other shifts."""
    if isinstance(draws, Counter):
        keys, paths = draws.keys ^ np.uint32(SHIFTS), draws.paths
    else:  # without numbers: the noise of a block identifies its paths
        digest = sha256(np.asarray(draws.step_noise).tobytes()).digest()
        keys = np.frombuffer(digest, np.uint32)[:4].reshape(2, 2)
        paths = np.arange(draws.size, dtype=np.uint32)
    counter = Counter(keys, paths, np.uint32(0), antithetic=False)  # pyright: ignore
    return ndtr(noise_of_steps(counter, horizon, size))


class Relaxation(Protocol):
    """The inner problem of a simulator: the best decisions with perfect foresight, penalised.

    - `terms`: the number of scalable parts of the penalty; 0 without a penalty.
    - `description`: a short description of the penalty, for a report.
    """

    @property
    def terms(self) -> int: ...

    @property
    def description(self) -> str: ...

    def best(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        """[N] an upper bound on the contribution of each path, with penalties subtracted.

        `rollout` has the policy's states ("state": leaves [T, N, …]) and final states on the same
        paths, whose exogenous part is the same for every policy; `scale` [terms] multiplies the
        penalty's parts (zeros: perfect foresight).
        """
        ...

    def charged(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        """[N] the penalties of the policy's decisions; their mean is zero."""
        ...


@runtime_checkable
class Relaxable(Protocol):
    """A simulator that defines its relaxation."""

    def relaxation(self, problem: Problem) -> Relaxation: ...


UNKNOWN = (
    "its simulator has no method `relaxation` and is not a stopping problem (see docs/bounds.md)"
)


def bounded(problem: Problem) -> bool:
    """Whether there is a relaxation, as far as this can be decided without computation."""
    return isinstance(problem.simulator, Relaxable) or isinstance(problem.action, Stop)


def relaxation_of(problem: Problem) -> Relaxation:
    """The relaxation of a simulator that has one, or of a problem whose only action is a `Stop`.

    **Raises:** `ValueError` if the problem has no relaxation, with the reason.
    """
    if isinstance(problem.simulator, Relaxable):
        return problem.simulator.relaxation(problem)
    if isinstance(problem.action, Stop):
        return StopRelaxation(problem)
    raise ValueError(UNKNOWN)
