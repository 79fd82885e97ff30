"""Why believe the number: the adjoint against bumps, and every declared limit of the simulator."""

from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.solver.certificate import certify_derivatives, feasibility, in_the_mean

from ..study import Part, StudyRun

PATHS = 256
ROUND_OFF = 1e-9  # of the largest number among the inputs, at least of one


def work(run: StudyRun) -> dict[str, Any]:
    """ "certificate": {"bump_check", "feasibility", "smoothing_gap", "policy_gradient_norm"}.

    Bumps are made at the inputs, and near them too where most paths lie on kinks; inputs whose
    derivative is right in the mean alone are judged by their move. Limits are those of the
    simulator's `slack`.
    """
    setup, solution = run.setup, run.solution
    problem, policy, engine = setup.problem, solution.policy, setup.engines.evaluate
    if policy is None:
        raise ValueError("the run has no policy")
    bumps = certify_derivatives(problem, policy, PATHS, engine=engine)
    verdicts = (solution.sensitivities.verdicts if solution.sensitivities else None) or {}
    limits = feasibility(problem, policy, engine=engine)
    round_off = ROUND_OFF * largest(problem)
    return {
        "certificate": {
            "bump_check": [bump.row() for bump in bumps] + in_the_mean(problem, verdicts),
            "feasibility": [limit.row(round_off) for limit in limits],
            "smoothing_gap": solution.smoothing_gap,
            "policy_gradient_norm": solution.policy_gradient_norm,
        }
    }


CERTIFICATE = Part("certificate", work, needs=("training",))


def largest(problem: Problem) -> float:
    """The size of the largest number among the inputs, at least one."""
    sizes = [np.max(np.abs(given.value), initial=1.0) for given in problem.named.values()]
    return float(max(sizes, default=1.0))
