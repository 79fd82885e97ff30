"""A case with a user-defined simulator, as read from its file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from snapo.case.given import FilePosition
from snapo.case.settings import EvaluationTable, FollowingTable
from snapo.problem.objective import Limit, Objective
from snapo.problem.record import Input
from snapo.problem.simulator import Simulator


@dataclass(frozen=True, eq=False)
class OwnCase:
    """The data that `snapo solve` needs from a case.

    - `location`: module and class of the simulator; `code`: the file of the module, if there is
      one, and `code_hash`: the hash of the file's bytes.
    - `unit`: the unit of the value; `units`: units by the name of a state, the action or an output.
    - `objective_words`: the objective as text, "mean of cash"; `outputs`: {key in the case: output}
      for all outputs in the objective.
    - `positions`: {input: the positions of its numbers in the files}.
    - `step`: the noun for one step, "week".
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    step: str
    location: tuple[str, str]
    code: Path | None
    code_hash: str
    simulator: Simulator
    inputs: Mapping[str, Input]
    objective: Objective
    objective_words: str
    outputs: Mapping[str, str]
    unit: str
    units: Mapping[str, str]
    training: FollowingTable
    evaluation: EvaluationTable
    positions: Mapping[str, tuple[FilePosition, ...]]

    @property
    def constraints(self) -> tuple[Limit, ...]:
        """The limits that the simulator's class defines."""
        return tuple(getattr(self.simulator, "constraints", ()))
