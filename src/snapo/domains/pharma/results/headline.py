"""The headline of a run: the probability that a batch keeps all limits."""

from typing import Any

from snapo.study.study import StudyRun

from ..flowsheet.case import PharmaCase
from .checks import status


def result(case: PharmaCase, run: StudyRun) -> dict[str, Any]:
    """The value is that of the policy, or of the recipe as it stands."""
    capable, loop = run.get("capability", {}), run.get("closed_loop", {})
    recipe = 1 - capable["joint"] if capable else None
    found: dict[str, Any] = {
        "value": recipe,
        "standard_error": capable.get("joint_error"),
        "meaning": "probability that a batch keeps all limits",
        "references": {},
        "engine": "none: no policy is trained",
        "paths": {"evaluate": capable.get("batches", 0)},
        "seed": case.training.seed,
        "status": status(run),
    }
    if not loop:
        return found
    references = {"recipe_as_given": recipe, "best_fixed_recipe": loop["baseline"]}
    if case.goal.kind != "probability":
        references |= {"goal": loop["objective"], "goal_of_recipe": loop["baseline_objective"]}
    found |= {key: loop[key] for key in ("value", "standard_error", "engine", "paths")}
    if found["status"] == "ok":
        found["status"] = loop["status"]
    return found | {"references": references}
