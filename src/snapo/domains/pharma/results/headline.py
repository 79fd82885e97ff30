"""The headline of a run: the probability that a batch keeps all limits."""

from collections.abc import Mapping
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
        "meaning": "probability that a batch keeps all limits, by the recipe as given",
        "references": {},
        "engine": "none: no policy is trained",
        "paths": {"evaluate": capable.get("batches", 0)},
        "seed": case.training.seed,
        "status": status(run),
    }
    best = run.get("optimise")
    if best:
        found["references"] = {"optimised_recipe": best["chance"][1]["probability"]}
    if not loop:
        return found
    references = {"recipe_as_given": loop["given"], "best_fixed_recipe": loop["baseline"]}
    references |= found["references"]
    if case.goal.kind != "probability":
        references |= {"goal": loop["objective"], "goal_of_recipe": loop["baseline_objective"]}
    found |= {key: loop[key] for key in ("value", "standard_error", "engine", "paths")}
    if found["status"] == "ok":
        found["status"] = loop["status"]
    meaning = "probability that a batch keeps all limits, under the trained policy"
    return found | {"references": references, "meaning": meaning, "verdict": verdict(loop)}


def verdict(loop: Mapping[str, Any]) -> str:
    """Which rival is to be taken, in a sentence."""
    both = f"{100 * loop['value']:.1f} % under the policy, {100 * loop['baseline']:.1f} % under "
    both += "the best fixed recipe, on the same batches"
    match loop["better"]:
        case "policy":
            return f"The policy does better than the best fixed recipe: {both}."
        case "recipe":
            return f"The best fixed recipe does better than the policy: {both}. Take the recipe."
        case _:
            return f"The policy is not told from the best fixed recipe: {both}."
