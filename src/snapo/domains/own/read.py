"""From the tables of a case and the user's own class to the records that a study needs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.settings import (
    EvaluationTable,
    FollowingTable,
    check_window,
    read_evaluation,
    read_training,
)
from snapo.case.table import parse
from snapo.problem.simulator import Simulator
from snapo.study.solving.prepare import use_every_core

from .inputs import read_inputs
from .load import importable, load_class, readable
from .objective import objective_of, read_aims, unit_of, words_of
from .records import OwnCase
from .tables import InputTable, OwnTable

FORMATS = {
    "": OwnTable,
    "inputs.*": InputTable,
    "training": FollowingTable,
    "evaluation": EvaluationTable,
}


def read_case(file: Path, data: Mapping[str, Any], position: tuple[str, str]) -> OwnCase:
    """Reads all tables, then the code, so that a mistake in the file is found first."""
    table, name = parse(OwnTable, data, str(file), ""), str(file)
    notes: list[str] = []
    training = read_training(table.training, name, FollowingTable)
    evaluation = read_evaluation(table.evaluation, name)
    inputs, positions = read_inputs(table.inputs, file, notes)
    aims = read_aims(table.objective, name)
    check_window(training, [aim.table.kind for aim in aims], name)
    use_every_core()  # before the user's module computes anything
    code = load_class(*position, file.parent)
    simulator = _made(code.value, code.file, table, data, file)
    return OwnCase(
        file=file,
        notes=tuple(notes),
        title=table.title or position[1],
        step=table.step,
        location=position,
        code=code.file,
        code_hash=code.hash,
        simulator=simulator,
        inputs=inputs,
        objective=objective_of(aims),
        objective_words=words_of(aims),
        outputs={item.key: item.output for item in aims},
        unit=unit_of(aims, table.units),
        units=table.units,
        training=training,
        evaluation=evaluation,
        positions=positions,
    )


def _made(
    simulator: type[Simulator], code: Path | None, table: OwnTable, data: Mapping, file: Path
) -> Simulator:
    """The simulator: made by its class method `from_case(tables, folder)`, or without arguments."""
    maker = getattr(simulator, "from_case", None)
    if maker is None and table.simulator:
        message = (
            f"{simulator.__name__} has no class method from_case(tables, folder) that would read it"
        )
        raise CaseError(str(file), "simulator", table.simulator, message)
    position = code or Path(simulator.__name__)
    with importable(position.parent), readable(position):
        made: Any = maker(data, file.parent) if maker else simulator()  # pyright: ignore
    if not isinstance(made, Simulator):
        message = f"from_case must return a simulator, and returns a {type(made).__name__}"
        raise CaseError(str(position), "", None, message)
    return made
