"""Why to believe the number: the adjoint against bumps, limits kept, homogeneity in the curve."""

from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.solver.certificate import nudged
from snapo.solver.solution import Solution
from snapo.study.parts.certificate import certificate
from snapo.study.study import Setup, StudyRun

from ..setup import OUTPUT, beside, case_of

TRIES = 16  # at finding inputs nearby that still can be met


def off_ties(problem: Problem) -> Problem:
    """The problem a hair away, where the contract still can be met, for a check by differences.

    With round numbers a store fills or empties on the very day that its rates allow, and a full
    one without losses stays exactly full: kinks on every path.
    """
    for seed in range(TRIES):
        moved = nudged(problem, seed)
        steps, inventory = moved.schedule.steps, moved.schedule.constants.inventory
        if np.all(steps.low <= steps.high) and steps.low[0] <= inventory <= steps.high[0]:
            return moved
    return problem


def homogeneity(setup: Setup, solution: Solution) -> dict[str, float] | None:
    """Sum of F x delta = value + present value of costs, decisions held, on the same paths.

    It holds path by path for any policy, where prices are the forward curve times noise and all
    of the value is paid in gas and proportional costs.
    """
    table, case = solution.sensitivities, case_of(setup)
    if table is None or not case.model.proportional:
        return None
    evaluation, curve = setup.evaluation, case.market.forward_curve
    source = setup.problem.sources.evaluation
    paths = source.available(min(evaluation.sensitivity_paths, evaluation.paths))
    left = float(np.sum(curve.values * table.held[curve.name].value))
    earned = np.asarray(solution.totals[OUTPUT]) + np.asarray(solution.totals["costs"])
    right = float(np.mean(earned[:paths]))
    return {"left": left, "right": right, "error": left - right, "paths": paths}


def _more(run: StudyRun) -> dict[str, Any]:
    return {
        "homogeneity": homogeneity(run.setup, run.solution),
        "control_variate": {"explained": run.solution.control},
    }


CERTIFICATE = certificate(
    bump_paths=512,
    tolerance=lambda problem: 1e-6 * float(problem.schedule.constants.rate_scale),
    near=off_ties,
    problem_of=beside,
    more=_more,
)
