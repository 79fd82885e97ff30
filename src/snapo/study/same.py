"""Whether two simulators are one program: then code compiled for one serves the other.

A simulator may use a number of its case as a plain constant beside the differentiable inputs, as
the scale of a feature or a choice between two formulas. Traced, the constant stands in the program.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem import inputs as inputs_
from snapo.problem.problem import Problem
from snapo.problem.simulator import Simulator, at
from snapo.problem.smooth import Exact

PROGRAM = "_program"  # under which a problem keeps its own


def same_program(problem: Problem, other: Simulator) -> bool:
    """Whether `other`, in place of the problem's simulator, computes the same functions.

    Both are traced at the problem's inputs; nothing is compiled. The problem keeps its own program:
    a page asks again at every move.
    """
    with jax.enable_x64(True):
        known = problem.__dict__.get(PROGRAM)
        if known is None:
            known = problem.__dict__[PROGRAM] = _traced(problem, problem.simulator)
        return known == _traced(problem, other)


def _traced(problem: Problem, simulator: Simulator) -> tuple[str, tuple[bytes, ...]]:
    """The program of one path as text, and the constants in it."""
    values = [jnp.asarray(value) for value in inputs_.values(problem.inputs)]
    noise = jnp.zeros(simulator.noise_size), jnp.zeros(simulator.initial_noise_size)

    def path(values, noise, action) -> Any:
        schedule = simulator.prepare(inputs_.replace(problem.inputs, values))
        schedule = jax.tree.map(jnp.asarray, schedule)
        now = at(schedule.steps, 0)
        state = simulator.initial(schedule.constants, noise[1])
        seen = simulator.observe(schedule.constants, now, state)
        after = simulator.step(schedule.constants, now, state, action, noise[0], Exact())
        end = simulator.terminal(schedule.constants, state, Exact())
        return eqx.filter((schedule, seen, after, end), eqx.is_array)

    action = jnp.zeros(simulator.action.size)
    closed = jax.make_jaxpr(path)(values, noise, action)
    return str(closed.jaxpr), tuple(np.asarray(each).tobytes() for each in closed.consts)
