"""From the tables of a case and the user's own class to the records that a study needs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.objective import make_objective
from snapo.case.settings import (
    FollowingTable,
    ObjectiveTable,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
)
from snapo.case.table import parse
from snapo.problem.simulator import Simulator
from snapo.study.cores import use_every_core

from .inputs import read_inputs
from .load import beside, load_class, readable
from .records import OwnCase
from .tables import OwnTable


def read_case(file: Path, data: Mapping[str, Any], place: tuple[str, str]) -> OwnCase:
    """Reads all tables, then the code, so that a mistake in the file is found first."""
    table, name = parse(OwnTable, data, str(file), ""), str(file)
    notes: list[str] = []
    training = read_training(table.training, name, FollowingTable)
    evaluation = read_evaluation(table.evaluation, name)
    inputs = read_inputs(table.inputs, file, notes)
    output = _output(table.objective, name)
    rest = {key: value for key, value in table.objective.items() if key != "output"}
    objective = read_objective(rest, name)
    check_window(training, [objective.kind], name)
    use_every_core()  # before the user's module computes anything
    code = load_class(*place, file.parent)
    simulator = _made(code.found, code.file, table, data, file)
    return OwnCase(
        file=file,
        notes=tuple(notes),
        title=table.title or place[1],
        step=table.step,
        place=place,
        code=code.file,
        code_hash=code.hash,
        simulator=simulator,
        inputs=inputs,
        objective=make_objective(objective, output),
        objective_words=_words(objective, output),
        output=output,
        unit=table.units.get(output, "") if objective.keeps_unit else "",
        units=table.units,
        training=training,
        evaluation=evaluation,
    )


def _output(objective: Mapping[str, Any], name: str) -> str:
    found = objective.get("output")
    if not isinstance(found, str) or not found:
        what = "it is the name of the simulator's output that is made as large as possible"
        what = f"this key is missing; {what}" if found is None else what
        raise CaseError(name, "objective.output", found, what)
    return found


def _words(objective: ObjectiveTable, output: str) -> str:
    """The objective as a phrase."""
    name = output.replace("_", " ")
    if objective.kind == "cvar":
        return f"mean of the worst {100 * (1 - (objective.level or 0.95)):.3g} % of {name}"
    return f"{objective.kind.replace('-', ' ').replace('crra', 'expected utility')} of {name}"


def _made(
    found: type[Simulator], code: Path | None, table: OwnTable, data: Mapping, file: Path
) -> Simulator:
    """The simulator: made by its class method `from_case(tables, folder)`, or without arguments."""
    maker = getattr(found, "from_case", None)
    if maker is None and table.simulator:
        what = f"{found.__name__} has no class method from_case(tables, folder) that would read it"
        raise CaseError(str(file), "simulator", table.simulator, what)
    place = code or Path(found.__name__)
    with beside(place.parent), readable(place):
        made: Any = maker(data, file.parent) if maker else found()  # pyright: ignore
    if not isinstance(made, Simulator):
        what = f"from_case must return a simulator, and returns a {type(made).__name__}"
        raise CaseError(str(place), "", None, what)
    return made
