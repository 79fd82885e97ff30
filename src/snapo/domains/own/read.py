"""From the tables of a case and the user's own class to the records that a study needs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.csv import Mention, read_rows
from snapo.case.error import CaseError
from snapo.case.settings import FollowingTable, check_window, read_evaluation, read_training
from snapo.case.table import Section, parse
from snapo.problem.inputs import Input
from snapo.problem.simulator import Simulator
from snapo.study.cores import use_every_core

from .load import beside, load_class, readable
from .objective import objective_of, read_aims, unit_of, words_of
from .records import OwnCase
from .tables import InputTable, OwnTable

SAID = ("unit", "words", "group", "bump", "move", "trade_unit", "trade_factor")


def read_inputs(tables: Mapping[str, Any], file: Path, notes: list[str]) -> dict[str, Input]:
    """{name: input} in the order of the file; `prepare` receives arrays under the same names."""
    return {name: _input(name, table, file, notes) for name, table in tables.items()}


def _input(name: str, data: Any, file: Path, notes: list[str]) -> Input:
    where = f"inputs.{name}"
    if not isinstance(data, Mapping):
        what = f'an input is a table: {name} = {{ value = 60, unit = "hm3" }}'
        raise CaseError(str(file), where, data, what)
    table = parse(InputTable, data, str(file), where)
    if table.move == 0:
        raise CaseError(str(file), f"{where}.move", 0.0, "allowed is a number other than 0")
    section = Section(file, where, notes)
    values, labels = _from_csv(section, table) if table.file else _in_file(section, table)
    return Input(values, labels=labels, **{key: getattr(table, key) for key in SAID})


def _in_file(section: Section, table: InputTable) -> tuple[np.ndarray, tuple[str, ...]]:
    """The numbers under `value`, any shape."""
    if table.value is None:
        what = 'this key is missing; give value = 60, or file = "x.csv" with column = "price"'
        raise section.error("value", None, what)
    for key in ("column", "label"):
        if getattr(table, key) is not None:
            raise section.error(key, getattr(table, key), "it belongs to a file, not to a value")
    try:
        values = np.array(table.value, np.float64)
    except ValueError:
        raise section.error("value", table.value, "all rows must have the same length") from None
    labels = tuple(table.labels or ())
    if labels and len(labels) != values.size:
        what = f"there are {values.size} numbers; give each one label"
        raise section.error("labels", table.labels, what)
    return values, labels


def _from_csv(section: Section, table: InputTable) -> tuple[np.ndarray, tuple[str, ...]]:
    """The numbers of a column, with the texts of another one as labels."""
    assert table.file is not None
    if table.value is not None:
        raise section.error("value", table.value, "an input has a value or a file, not both")
    if table.labels is not None:
        raise section.error("labels", table.labels, "a file labels its numbers by a column: label")
    if not table.column:
        raise section.error("column", table.column, "allowed is the name of a column of the file")
    column, label = table.column.lower(), (table.label or "").lower()
    rows = read_rows(Mention(section, "file", table.file), [c for c in (column, label) if c])
    values = np.array([row.number(column) for row in rows])
    return values, tuple(row.label(label) for row in rows) if label else ()


def read_case(file: Path, data: Mapping[str, Any], place: tuple[str, str]) -> OwnCase:
    """Reads all tables, then the code, so that a mistake in the file is found first."""
    table, name = parse(OwnTable, data, str(file), ""), str(file)
    notes: list[str] = []
    training = read_training(table.training, name, FollowingTable)
    evaluation = read_evaluation(table.evaluation, name)
    inputs = read_inputs(table.inputs, file, notes)
    aims = read_aims(table.objective, name)
    check_window(training, [each.table.kind for each in aims], name)
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
        objective=objective_of(aims),
        objective_words=words_of(aims),
        outputs={each.key: each.output for each in aims},
        unit=unit_of(aims, table.units),
        units=table.units,
        training=training,
        evaluation=evaluation,
    )


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
