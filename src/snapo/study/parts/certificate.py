"""Why believe the number: the adjoint against bumps, and every declared limit of the simulator."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.solver.certificate import certify_derivatives, feasibility, in_the_mean, nudged

from ..study import Part, Setup, StudyRun
from ..training import TRAINING

BUMP_PATHS, LIMIT_PATHS = 256, 4096
ROUND_OFF = 1e-9  # of the largest number among the inputs, at least of one


def largest(problem: Problem) -> float:
    """The size of the largest number among the inputs, at least one."""
    sizes = [np.max(np.abs(entry.value), initial=1.0) for entry in problem.named.values()]
    return float(max(sizes, default=1.0))


def round_off(problem: Problem) -> float:
    """By how much a limit may be missed in arithmetic, in the largest unit of the inputs."""
    return ROUND_OFF * largest(problem)


def certificate(
    *,
    bump_paths: int = BUMP_PATHS,
    tolerance: Callable[[Problem], float] = round_off,
    near: Callable[[Problem], Problem] = nudged,
    problem_of: Callable[[Setup], Problem] = lambda setup: setup.problem,
    more: Callable[[StudyRun], Mapping[str, Any]] = lambda run: {},
) -> Part:
    """The part "certificate": bumps, limits, the smoothing gap and the policy's gradient.

    Bumps are made at the inputs, and near them too where most paths lie on kinks; inputs whose
    derivative is right in the mean alone are judged by their move. Limits are those of the
    simulator's `slack`.

    **Arguments:**

    - `bump_paths`: of the differences.
    - `tolerance`: by how much a limit may be missed; `near`: the problem a little away from kinks.
    - `problem_of`: the problem to certify; `more`: figures of the domain's own.
    """

    def work(run: StudyRun) -> dict[str, Any]:
        setup, solution = run.setup, run.solution
        problem, policy, engine = problem_of(setup), solution.policy, setup.engines.evaluate
        if policy is None:
            raise ValueError("the run has no policy")
        paths = min(LIMIT_PATHS, setup.evaluation.paths)
        bumps = certify_derivatives(
            problem, policy, paths=min(bump_paths, paths), near=near, engine=engine
        )
        limits = feasibility(problem, policy, paths=paths, engine=engine)
        verdicts = (solution.sensitivities.verdicts if solution.sensitivities else None) or {}
        least = tolerance(problem)
        return {
            "certificate": {
                "bump_check": [bump.row() for bump in bumps] + in_the_mean(problem, verdicts),
                "feasibility": [limit.row(least) for limit in limits],
                "smoothing_gap": solution.smoothing_gap,
                "policy_gradient_norm": solution.policy_gradient_norm,
                **more(run),
            }
        }

    return Part("certificate", work, (TRAINING.name,))


CERTIFICATE = certificate()
