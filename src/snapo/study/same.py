"""Whether two simulators are one program: then code compiled for one serves the other.

A simulator may use a number of its case as a plain constant beside the differentiable inputs, as
the scale of a feature or a choice between two formulas. Traced, the constant stands in the program.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from snapo.problem import inputs as inputs_
from snapo.problem.code.program import Text, text
from snapo.problem.code.version import of_preparation
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
        version = of_preparation(problem.simulator, problem.inputs), problem.version
        known = problem.__dict__.get(PROGRAM)
        if known is None or known[0] != version:
            known = version, _traced(problem, problem.simulator)
            problem.__dict__[PROGRAM] = known
        return known[1] == _traced(problem, other)


def _traced(problem: Problem, simulator: Simulator) -> Text:
    """The program of one path as text, and its constants."""
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
    return text(path, values, noise, action)
