"""The data of a control case."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from snapo.case.given import FilePosition
from snapo.case.settings import EvaluationTable, FollowingTable
from snapo.problem.objective import Objective
from snapo.problem.policy import Policy

from .inputs import PlantInputs
from .plants.plant import Plant


@dataclass(frozen=True, eq=False)
class ControlCase:
    """All that a study needs: the plant with its inputs, the objective, and how it is trained.

    - `recipe`: of the policy that is trained; `objective_words`: "mean reward".
    - `positions`: {input: the positions of its numbers in the file}.
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    plant: Plant
    inputs: PlantInputs
    objective: Objective
    objective_words: str
    recipe: Policy
    training: FollowingTable
    evaluation: EvaluationTable
    positions: Mapping[str, tuple[FilePosition, ...]]


def unit(text: str) -> str:
    """A unit, or the text for a pure number."""
    return "a pure number" if text in ("", "1") else text
