"""Reads a case with a user-defined simulator: its tables, `[inputs]` and `[objective]`."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import FilePosition, positions
from snapo.case.objective import make_objective
from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import (
    EvaluationKey,
    EvaluationTable,
    FollowingTable,
    ObjectiveTable,
    TrainingKey,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
    read_weight,
)
from snapo.case.table import CaseTable, Range, TableContext, Title, doc, parse
from snapo.problem.objective import Objective, Weighted
from snapo.problem.record import Input
from snapo.problem.simulator import Simulator
from snapo.study.prepare import use_every_core

from .load import importable, load_class, readable
from .records import OwnCase

FACTOR = ": the number of trade units in one unit"
NumberArray = float | list[float] | list[list[float]]


class OwnTable(CaseTable):
    """The whole file; the tables in it are read as records of other classes."""

    kind: str = doc("kind of the case")
    title: Title = ""
    step: str = doc(
        "noun of one step of the simulator",
        "step",
        'the noun for one step of the simulator, such as "week"',
    )
    objective: dict[str, Any] | list[dict[str, Any]] = doc(
        "statistics of the paths that are maximised",
        {},
        "one table [objective], or several tables [[objective]]",
    )
    inputs: dict[str, Any] = doc("inputs of the simulator, by name", {}, "a table, [inputs]")
    units: dict[str, str] = doc(
        "units in reports", {}, "a table of units, by name of a state, the action or an output"
    )
    report: ReportKey
    training: TrainingKey
    evaluation: EvaluationKey
    simulator: dict[str, Any] = doc(
        "table that the simulator reads in its method `from_case`", {}, "a table, [simulator]"
    )


class InputTable(CaseTable):
    """One entry of `[inputs]`: numbers in the file or a column of a CSV, and their meaning."""

    value: NumberArray | None = doc(
        "numbers of the input", None, "a number, or an array of numbers"
    )
    file: str | None = doc("file of numbers", None, "the name of a .csv file next to the case")
    column: str | None = doc("column of the numbers", None, "the name of a column of the file")
    label: str | None = doc(
        "column of the labels of the numbers",
        None,
        "the name of the column that labels the numbers",
    )
    labels: list[str] | None = doc(
        "labels of the numbers", None, "a list with one text for every number"
    )
    unit: str = doc("unit of the numbers", "", 'text, like "EUR/MWh"')
    words: str = doc("meaning of the input, in reports", "", "the meaning of the input, as text")
    group: str = doc("family of risk that the input belongs to", "", "the family of risk, as text")
    bump: Annotated[float, Range(0, endpoints="()", note=", in the unit")] | None = doc(
        "step of the finite difference that tests the derivative", None
    )
    move: float | None = doc(
        "standard move; reports show its effect", None, "a number other than 0, in the unit"
    )
    trade_unit: str = doc("unit in reports", "", "the name of the preferred display unit, as text")
    trade_factor: Annotated[float, Range(0, endpoints="()", note=FACTOR)] = doc(
        "number of trade units in one unit", 1.0
    )


ATTRIBUTES = {  # keys of the table that an input has, and the names that it has for them
    "unit": "unit", "words": "meaning", "group": "group", "bump": "bump", "move": "move",
    "trade_unit": "display_unit", "trade_factor": "display_factor",
}  # fmt: skip

APART = Plausible(-math.inf, math.inf, "", ratio=50.0)  # numbers in a row are not so far apart
PERCENT = re.compile("%|point|percent")


Positions = tuple[FilePosition, ...]


def read_inputs(
    tables: Mapping[str, Any], file: Path, notes: list[str]
) -> tuple[dict[str, Input], dict[str, Positions]]:
    """{name: input} in the order of the file, and {name: positions of its numbers}.

    `prepare` receives arrays under the same names.
    """
    pairs = {name: _input(name, table, file, notes) for name, table in tables.items()}
    inputs = {name: entry for name, (entry, _) in pairs.items()}
    entries = [checked_numbers(entry, name) for name, entry in inputs.items()]
    files = CaseFiles(file, {"inputs": tables})
    notes += implausible(entries, [*_shares(entries), APART], files).values()
    return inputs, {name: locations for name, (_, locations) in pairs.items()}


def _shares(entries: Sequence[CheckedNumbers]) -> Iterator[Plausible]:
    """The plausible ranges of shares, which are numbers displayed in percentage points or basis
    points."""
    for entry in entries:
        if entry.display_factor == 100 and PERCENT.search(entry.display_unit):
            hint = "a fraction is expected, such as 0.01 for 1 %"
            yield Plausible(0.0, 5.0, hint, names=(entry.name,), ratio=APART.ratio, by_size=True)
        if entry.display_factor == 1e4 and entry.display_unit == "bp":
            hint = "a fraction is expected, such as 0.0001 for 1 bp"
            yield Plausible(0.0, 0.5, hint, names=(entry.name,), by_size=True)


def _input(name: str, data: Any, file: Path, notes: list[str]) -> tuple[Input, Positions]:
    where = f"inputs.{name}"
    if not isinstance(data, Mapping):
        message = f'an input must be a table: {name} = {{ value = 60, unit = "hm3" }}'
        raise CaseError(str(file), where, data, message)
    table = parse(InputTable, data, str(file), where)
    if table.move == 0:
        raise CaseError(str(file), f"{where}.move", 0.0, "it must be a number other than 0")
    section = TableContext(file, where, notes)
    values, labels, locations = (_from_csv if table.file else _in_file)(section, table)
    attributes = {name: getattr(table, key) for key, name in ATTRIBUTES.items()}
    return Input(values, labels=labels, **attributes), locations


InputParts = tuple[np.ndarray, tuple[str, ...], Positions]


def _in_file(section: TableContext, table: InputTable) -> InputParts:
    """The numbers at `value`, of any shape."""
    if table.value is None:
        message = 'this key is missing; write value = 60, or file = "x.csv" with column = "price"'
        raise section.error("value", None, message)
    for key in ("column", "label"):
        if getattr(table, key) is not None:
            raise section.error(
                key,
                getattr(table, key),
                "this key is for an input with a file, but the input has a value",
            )
    try:
        values = np.array(table.value, np.float64)
    except ValueError:
        raise section.error("value", table.value, "all rows must have the same length") from None
    labels = tuple(table.labels or ())
    if labels and len(labels) != values.size:
        message = f"there must be {values.size} labels, one for every number"
        raise section.error("labels", table.labels, message)
    return values, labels, positions((*section.keys, "value"), values.shape)


def _from_csv(section: TableContext, table: InputTable) -> InputParts:
    """The numbers of a column, with the texts of another column as labels."""
    assert table.file is not None
    if table.value is not None:
        raise section.error(
            "value", table.value, "an input must have either a value or a file, not both"
        )
    if table.labels is not None:
        raise section.error(
            "labels",
            table.labels,
            "the labels of a file are in one of its columns; name the column with the key label",
        )
    if not table.column:
        raise section.error("column", table.column, "it must be the name of a column of the file")
    column, label = table.column.lower(), (table.label or "").lower()
    rows = read_rows(FileReference(section, "file", table.file), [c for c in (column, label) if c])
    values = np.array([row.number(column) for row in rows])
    labels = tuple(row.label(label) for row in rows) if label else ()
    return values, labels, tuple(row.position(column) for row in rows)


class Aim(NamedTuple):
    """`weight` times one objective of one output; `key`: its key in the case."""

    key: str
    weight: float
    output: str
    table: ObjectiveTable

    @property
    def description(self) -> str:
        """The objective as text."""
        name, table = self.output.replace("_", " "), self.table
        if table.kind == "cvar":
            return f"mean of the worst {100 * (1 - (table.level or 0.95)):.3g} % of {name}"
        return f"{table.kind.replace('-', ' ').replace('crra', 'expected utility')} of {name}"


def read_aims(data: Any, file: str) -> tuple[Aim, ...]:
    """Reads one objective, or several that are added up."""
    many = isinstance(data, list)
    if many and not data:
        raise CaseError(file, "objective", data, "at least one table is needed, [objective]")
    return tuple(
        _aim(item, f"objective.{i}" if many else "objective", file)
        for i, item in enumerate(data if many else [data], 1)
    )


def objective_of(aims: tuple[Aim, ...]) -> Objective:
    """The weighted sum of the objectives."""
    terms = [(aim.weight, make_objective(aim.table, aim.output)) for aim in aims]
    return terms[0][1] if len(terms) == 1 and terms[0][0] == 1 else Weighted(*terms)


def words_of(aims: tuple[Aim, ...]) -> str:
    """The objectives as text: "mean of cash + 0.5 x mean of the worst 10 % of cash"."""
    text = ""
    for aim in aims:
        sign = "" if not text and aim.weight > 0 else "- " if aim.weight < 0 else "+ "
        factor = "" if abs(aim.weight) == 1 else f"{abs(aim.weight):g} × "
        text += f"{' ' if text else ''}{sign}{factor}{aim.description}"
    return text


def unit_of(aims: tuple[Aim, ...], units: Mapping[str, str]) -> str:
    """The unit of the sum: the unit of its parts if they all have the same one, else ""."""
    result = {units.get(aim.output, "") if aim.table.keeps_unit else "" for aim in aims}
    return result.pop() if len(result) == 1 else ""


def _aim(data: Any, name: str, file: str) -> Aim:
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, "this must be a table, [objective]")
    output = data.get("output")
    if not isinstance(output, str) or not output:
        message = "it must be the name of the simulator's output to maximise"
        message = f"this key is missing; {message}" if output is None else message
        raise CaseError(file, f"{name}.output", output, message)
    rest = {key: value for key, value in data.items() if key not in ("weight", "output")}
    table = read_objective(rest, file, name)
    return Aim(name, read_weight(data, table, file, name), output, table)


FORMATS = {
    "": OwnTable,
    "inputs.*": InputTable,
    "report": ReportTable,
    "training": FollowingTable,
    "evaluation": EvaluationTable,
}


def read_case(file: Path, data: Mapping[str, Any], position: tuple[str, str]) -> OwnCase:
    """Reads all tables, then the code, so that a mistake in the file is reported first."""
    table, name = parse(OwnTable, data, str(file), ""), str(file)
    parse(ReportTable, table.report, name, "report")
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
    """The simulator, made by its class method `from_case(tables, folder)` or, if it has none,
    without arguments."""
    maker = getattr(simulator, "from_case", None)
    if maker is None and table.simulator:
        message = (
            f"{simulator.__name__} has no class method from_case(tables, folder), which must read "
            f"this table"
        )
        raise CaseError(str(file), "simulator", table.simulator, message)
    position = code or Path(simulator.__name__)
    with importable(position.parent), readable(position):
        made: Any = maker(data, file.parent) if maker else simulator()  # pyright: ignore
    if not isinstance(made, Simulator):
        message = f"from_case must return a simulator, but returned a {type(made).__name__}"
        raise CaseError(str(position), "", None, message)
    return made
