"""A case made ready to solve: the steps that every domain's setup has in common."""

from collections.abc import Callable
from typing import Any

from snapo.case.error import CaseError
from snapo.engine import Choice, Engines, choose
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import Simulator

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
