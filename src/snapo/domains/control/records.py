"""A case of control, as it was read."""

from dataclasses import dataclass
from pathlib import Path

from snapo.case.settings import EvaluationTable, FollowingTable
from snapo.problem.objective import Objective

from .inputs import Inputs
from .plants.plant import Plant


@dataclass(frozen=True, eq=False)
class ControlCase:
    """All that a study needs: the plant with its inputs, the objective, and how it is trained.

    - `hidden`: widths of the policy's layers, if they are given; `objective_words`: "mean reward".
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    plant: Plant
    inputs: Inputs
    objective: Objective
    objective_words: str
    hidden: tuple[int, ...] | None
    training: FollowingTable
    evaluation: EvaluationTable
