"""A case made ready to solve: the steps that every domain's setup has in common."""

from collections.abc import Callable
from typing import Any

import jax

from snapo.case.error import CaseError
from snapo.engine import Choice, Engines, choose
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import Simulator
from snapo.solver.learning.following import fitted
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training

from .same import same_program
from .study import Setup


def engines_for(wanted: Choice, problem: Problem, policy: Policy) -> Engines:
    """The engines of a run.

    **Raises:** `CaseError` where the wanted one cannot take the problem; it says why.
    """
    try:
        return choose(wanted, problem, policy)
    except ValueError as error:
        what = str(error).removeprefix("engine: ")
        raise CaseError("--engine", "", wanted, what) from None


def following(
    engine: Choice, problem: Problem, recipe: Policy, training: Training, evaluation: Evaluation
) -> Setup:
    """The setup of a general policy, in which all that is not given follows the problem, as it
    does in `snapo.solve`.

    **Raises:** `CaseError` where the engine cannot take the problem.
    """
    policy = recipe.for_problem(problem.interface, jax.random.key(training.seed))
    engines = engines_for(engine, problem, policy)
    plan = fitted(training, problem, policy)
    return Setup(problem, policy, plan, evaluation, engines, recipe)


def at_values(
    setup: Setup, simulator: Simulator, values: dict[str, Any], anew: Callable[[], Setup]
) -> Setup:
    """The setup at other `values` of its inputs, with the code that is compiled already.

    `simulator` is that of the moved case. Where it uses a number as a plain constant, it is another
    program, and the setup is made `anew`.
    """
    if not same_program(setup.problem, simulator):
        return anew()
    return setup._replace(problem=setup.problem.at(values))
