"""The value between two bounds: the policy's from below, hindsight with a penalty from above."""

from typing import Any

from snapo.solver.bound import Penalty, bound

from ..study import Part, StudyRun

PATHS = 1024


def bounded(run: StudyRun, paths: int = PATHS, penalty: Penalty = "value") -> dict[str, Any]:
    """ "bound": lower, upper and gap with their intervals; see `snapo.solver.bound`.

    Lower is the value of the run, upper that and the gap: never below the value that stands beside.
    "says_little" says why, where the bound leaves open how good the policy is.

    **Raises:** `ValueError` where the study has no bound; it says why.
    """
    relaxation, setup = run.study.relaxation, run.setup
    if isinstance(relaxation, str):
        raise ValueError(relaxation)
    policy = run.solution.policy
    if policy is None:
        raise ValueError("the run has no policy")
    found = bound(
        setup.problem,
        policy,
        relaxation=relaxation(),
        paths=paths,
        penalty=penalty,
        engine=setup.engines.evaluate,
    )
    value, error = run.solution.value, run.solution.standard_error
    found = found.above(value, error, setup.problem.objective)
    run.tell(str(found))
    return {"bound": found.row()}


BOUND = Part("bound", bounded, needs=("training",))
