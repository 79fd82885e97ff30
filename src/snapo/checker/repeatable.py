"""Purity: two traces of a method must be the same program."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.code.version import read_context, text
from snapo.problem.simulator import Schedule, Simulator, at
from snapo.problem.smooth import Exact, Smooth

from .findings import Notes

SHAPE = jax.ShapeDtypeStruct


def repeatable(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Two traces of every method must be the same program."""
    noise: Any = np.full(simulator.noise_size, 0.1)
    action: Any = np.full(simulator.action.size, 0.5)
    initial_noise: Any = np.full(simulator.initial_noise_size, 0.1)

    with jax.enable_x64(True):
        # Arrays of JAX, as the engines give them: one of NumPy takes no index that is traced.
        constants, now = jax.tree.map(jnp.asarray, (schedule.constants, at(schedule.steps, 0)))
        start = jax.eval_shape(lambda: simulator.initial(constants, initial_noise))
        calls = {
            "prepare": lambda: (
                lambda v: simulator.prepare(inputs_.replace(inputs, v)),
                inputs_.values(inputs),
            ),
            "initial": lambda: (lambda z: simulator.initial(constants, z), initial_noise),
            "observe": lambda: (lambda s: simulator.observe(constants, now, s), start),
            "step": lambda: (
                lambda x: [
                    simulator.step(constants, now, x[0], x[1], x[2], smooth)
                    for smooth in (Exact(), Smooth(0.1))
                ],
                (start, action, noise),
            ),
            "terminal": lambda: (lambda s: simulator.terminal(constants, s, Exact()), start),
        }
        for name, fresh in calls.items():
            with notes.during(name):
                if _anew(text, *fresh()) == _anew(text, *fresh()):
                    continue
                # Programs may differ in print alone; numbers decide.
                both = [_filled(*fresh()) for _ in range(2)]
                first, second = (jax.tree.leaves(_anew(jax.jit(item), z)) for item, z in both)
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second)):
                notes.error(
                    notes.method(name),
                    "Two calls with the same arguments differ: randomness, a clock or a counter "
                    "in Python.",
                    "Use the noise that step is given, and carry what changes in the state.",
                )
    notes.stop_on_errors()


def _anew(function: Callable, *values: Any) -> Any:
    """A call for which JAX traces everything again, functions inside it that it has met too."""
    with read_context(object()):
        return function(*values)


def _filled(function: Callable, argument: PyTree) -> tuple[Callable, PyTree]:
    """A function and its argument, with ones for what has a shape alone."""

    def filled(leaf: Any) -> Any:
        return np.ones(leaf.shape, leaf.dtype) if isinstance(leaf, SHAPE) else leaf

    return function, jax.tree.map(filled, argument, is_leaf=lambda leaf: isinstance(leaf, SHAPE))
