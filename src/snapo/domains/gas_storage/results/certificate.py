"""Why to believe the number: the adjoint against bumps, limits kept, homogeneity in the curve."""

from typing import Any

import numpy as np

from snapo.problem.inputs import Input
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.solver import certificate as core
from snapo.solver.solution import Solution

from ..problem import OUTPUT, Problem

BUMP_PATHS, LIMIT_PATHS = 512, 4096
TRIES = 16  # at finding inputs nearby that still can be met
OFF_ZERO = 50.0  # bumps by which a zero is moved off its tie


def certificate(problem: Problem, solution: Solution, source: Scenarios) -> dict[str, Any]:
    """The adjoint against bumps, limits kept, the smoothing gap, and homogeneity in the curve."""
    engine, paths = problem.engines.evaluate, problem.case.model.paths
    given = (problem.simulator, off_ties(problem), solution.policy, problem.objective, source)
    bumps = core.bump_check(*given, paths(BUMP_PATHS), engine=engine)
    given = (problem.simulator, problem.schedule, solution.policy, source)
    limits = core.feasibility(*given, paths(LIMIT_PATHS), engine)
    slack = 1e-6 * float(problem.schedule.constants.rate_scale)
    return {
        "bump_check": [bump.row() for bump in bumps],
        "feasibility": [limit.row(slack) for limit in limits],
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
        "homogeneity": homogeneity(problem, solution),
        "control_variate": {"explained": solution.control},
    }


def off_ties(problem: Problem) -> dict[str, Input]:
    """The inputs a hair away, where the contract still can be met, for a check by differences.

    With round numbers a store fills or empties on the very day that its rates allow, and a full
    one without losses stays exactly full: kinks on every path. A zero moves where its input says
    by how much it may be bumped.
    """
    zeros = {name: OFF_ZERO * each.bump for name, each in problem.inputs.items() if each.bump}
    for seed in range(TRIES):
        inputs = core.nudged(problem.inputs, zeros, seed)
        schedule = prepare(problem.simulator, inputs)
        steps, inventory = schedule.steps, schedule.constants.inventory
        if np.all(steps.low <= steps.high) and steps.low[0] <= inventory <= steps.high[0]:
            return inputs
    return problem.inputs


def homogeneity(problem: Problem, solution: Solution) -> dict[str, float] | None:
    """Sum of F x delta = value + present value of costs, decisions held, on the same paths.

    It holds path by path for any policy, where prices are the forward curve times noise and all
    of the value is paid in gas and proportional costs.
    """
    table, case = solution.sensitivities, problem.case
    if table is None or not case.model.proportional:
        return None
    evaluation, curve = problem.evaluation, case.market.forward_curve
    paths = min(evaluation.sensitivity_paths, evaluation.paths)
    blocks = problem.sensitivity_source().blocks(paths)
    left = float(np.sum(curve.values * table.held[curve.name].value))
    earned = np.asarray(solution.totals[OUTPUT]) + np.asarray(solution.totals["costs"])
    right = float(np.mean([earned[block].mean() for block in blocks]))
    return {"left": left, "right": right, "error": left - right, "paths": sum(map(len, blocks))}
