"""Objective, training and evaluation of an inventory case, of one item or of a network."""

from typing import Any, Protocol

from snapo.case.error import CaseError
from snapo.case.settings import check_window, read_evaluation, read_objective, read_training


class FileWithSettings(Protocol):
    """A file with these tables."""

    objective: dict
    training: dict
    evaluation: dict


def read_settings(top: FileWithSettings, file: str) -> dict[str, Any]:
    """Objective, training and evaluation, as a case holds them.

    **Raises:** `CaseError` for every mistake, and for an objective that does not apply to costs.
    """
    settings = {
        "objective": read_objective(top.objective, file),
        "training": read_training(top.training, file),
        "evaluation": read_evaluation(top.evaluation, file),
    }
    kind = settings["objective"].kind
    check_window(settings["training"], [kind], file)
    if kind == "crra":
        message = "costs are not wealth; use mean, cvar, mean-variance, entropic or target"
        raise CaseError(file, "objective.kind", "crra", message)
    return settings
