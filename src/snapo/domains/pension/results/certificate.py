"""The evidence for the sensitivities: the adjoint against bumps, and every limit kept."""

from typing import Any

from snapo.solver.certificate import certify_derivatives, feasibility
from snapo.study.study import StudyRun

BUMP_PATHS, LIMIT_PATHS = 256, 4096
SLACK = 1e-9  # of a share: round-off


def work(run: StudyRun) -> dict[str, Any]:
    """ "certificate": bumps at the inputs, limits on the paths of the evaluation."""
    setup, solution = run.setup, run.solution
    problem, policy, engine = setup.problem, solution.policy, setup.engines.evaluate
    assert policy is not None
    available = min(LIMIT_PATHS, setup.evaluation.paths)
    bumps = certify_derivatives(problem, policy, min(BUMP_PATHS, available), engine=engine)
    limits = feasibility(problem, policy, available, engine=engine)
    return {
        "certificate": {
            "bump_check": [bump.row() for bump in bumps],
            "feasibility": [limit.row(SLACK) for limit in limits],
            "smoothing_gap": solution.smoothing_gap,
            "policy_gradient_norm": solution.policy_gradient_norm,
        }
    }
