"""Whether a decision acts as one of when to stop, although it is not written with `Stop`."""

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Actions, Box, Choice, Integers, Stop
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact


def ends_for_good(problem: Problem) -> bool:
    """Whether one extreme of the only decision takes a flag of the state from 1 to 0, or from 0 to
    1, for good, and the other one leaves it alone: an option that is exercised, a plant that is
    closed. From the first state, with all noise zero.
    """
    extremes = _extremes(problem.action)
    if extremes is None:
        return False
    # Arrays of JAX, as in an engine: user code may index them as such.
    simulator, schedule = problem.simulator, jax.tree.map(jnp.asarray, problem.schedule)
    noise = jnp.zeros(simulator.noise_size)
    now = at(schedule.steps, 0)

    @jax.jit
    def after(state, action):
        return simulator.step(schedule.constants, now, state, action, noise, Exact())[0]

    start = jnp.zeros(simulator.initial_noise_size)
    first = jax.jit(lambda: simulator.initial(schedule.constants, start))()
    for stop, go in (extremes, extremes[::-1]):
        stopped = after(first, stop)
        later = [after(stopped, action) for action in extremes]
        states = [_numbers(item) for item in (first, after(first, go), stopped, *later)]
        if any(_is_flag(*leaves) for leaves in zip(*states)):
            return True
    return False


def _extremes(action: Actions) -> tuple[np.ndarray, np.ndarray] | None:
    """The two ends of a decision of one number, or the two options of a choice; None elsewhere."""
    if isinstance(action, Choice) and action.size == 2:
        return np.array([1.0, 0.0]), np.array([0.0, 1.0])
    low, high = action.bounds()
    one = isinstance(action, Box | Integers) and not isinstance(action, Stop) and action.size == 1
    return (low, high) if one and np.isfinite(high - low).all() else None


def _numbers(state) -> list[np.ndarray]:
    return [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(state)]


def _is_flag(first, gone_on, stopped, *later) -> bool:
    """Whether a number of the state is 0 or 1, changes by a stop alone, and never again."""
    if first.size != 1 or first.item() not in (0.0, 1.0):
        return False
    selected = gone_on == first and all(item == stopped for item in later)
    return bool(selected and stopped == 1.0 - first)
