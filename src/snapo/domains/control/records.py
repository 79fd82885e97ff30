"""The data of a control case."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from snapo.case.given import FilePosition
from snapo.case.settings import EvaluationTable, FollowingTable, ObjectiveTable

from .inputs import PlantInputs
from .kinds import PlantKind


@dataclass(frozen=True, eq=False)
class ControlCase:
    """All that a study needs: the plant with its inputs, the objective, and the settings of
    training.

    - `kind`: the kind of the plant; `horizon`, `timer`: the number of steps, and whether the policy
      sees how many steps are left; None means the default of the kind.
    - `hidden`, `memory`, `window`: the keys of `[policy]`, which describe the trained network.
    - `objective_words`: the objective as text, "mean reward".
    - `positions`: {input: the positions of its numbers in the file}.
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    kind: type[PlantKind]
    horizon: int | None
    timer: bool | None
    inputs: PlantInputs
    objective: ObjectiveTable
    objective_words: str
    hidden: tuple[int, ...] | None
    memory: Literal["GRU", "Recent"] | None
    window: int | None
    training: FollowingTable
    evaluation: EvaluationTable
    positions: Mapping[str, tuple[FilePosition, ...]]


def unit(text: str) -> str:
    """The unit as text; a pure number has a text instead of "1"."""
    return "a pure number" if text in ("", "1") else text
