"""Prepares a case for `solve`: the steps that are common to the setups of all domains."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from snapo.case.error import CaseError
from snapo.engine import EngineName, Engines, choose
from snapo.problem import inputs as inputs_
from snapo.problem.code.version import ProgramText, of_preparation, text
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import Simulator, at
from snapo.problem.smooth import Exact
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training

from .study import Setup

PROGRAM = "_program"  # under which a problem keeps its own


def same_program(problem: Problem, other: Simulator) -> bool:
    """Whether `other` computes the same functions as the problem's simulator.

    Both are traced at the problem's inputs; nothing is compiled. The problem keeps its program,
    since a page needs this check at every move.
    """
    with jax.enable_x64(True):
        version = of_preparation(problem.simulator, problem.inputs), problem.version
        available = problem.__dict__.get(PROGRAM)
        if available is None or available[0] != version:
            available = version, _traced(problem, problem.simulator)
            problem.__dict__[PROGRAM] = available
        return available[1] == _traced(problem, other)


def _traced(problem: Problem, simulator: Simulator) -> ProgramText:
    """The traced program of one path as text, and its constants."""
    values = [jnp.asarray(value) for value in inputs_.values(problem.inputs)]
    noise = jnp.zeros(simulator.noise_size), jnp.zeros(simulator.initial_noise_size)

    def path(values, noise, action) -> Any:
        schedule = simulator.prepare(inputs_.replace(problem.inputs, values))
        schedule = jax.tree.map(jnp.asarray, schedule)
        now = at(schedule.steps, 0)
        state = simulator.initial(schedule.constants, noise[1])
        observed = simulator.observe(schedule.constants, now, state)
        after = simulator.step(schedule.constants, now, state, action, noise[0], Exact())
        end = simulator.terminal(schedule.constants, state, Exact())
        return eqx.filter((schedule, observed, after, end), eqx.is_array)

    action = jnp.zeros(simulator.action.size)
    return text(path, values, noise, action)


def engines_for(requested: EngineName, problem: Problem, policy: Policy) -> Engines:
    """The engines of a run.

    **Raises:** `CaseError` if the requested engine cannot run the problem, with the reason.
    """
    try:
        return choose(requested, problem, policy)
    except ValueError as error:
        message = str(error).removeprefix("engine: ")
        raise CaseError("--engine", "", requested, message) from None


def with_auto(
    engine: EngineName, problem: Problem, recipe: Policy, training: Training, evaluation: Evaluation
) -> Setup:
    """The setup of a general policy, in which all defaults are chosen from the problem, as
    in `snapo.solve`.

    **Raises:** `CaseError` if the engine cannot run the problem.
    """
    policy = recipe.for_problem(problem.interface, jax.random.key(training.seed))
    engines = engines_for(engine, problem, policy)
    plan = resolve_auto(training, problem, policy)
    return Setup(problem, policy, plan, evaluation, engines, recipe)


def at_values(
    setup: Setup, simulator: Simulator, values: dict[str, Any], rebuilt: Callable[[], Setup]
) -> Setup:
    """The setup at new `values` of its inputs, with the code that is already compiled. `simulator`:
    the simulator of the moved case. If it uses a moved number as a plain constant, it is a
    different program, and `rebuilt` makes the setup.
    """
    if not same_program(setup.problem, simulator):
        return rebuilt()
    return setup._replace(problem=setup.problem.at(values))
