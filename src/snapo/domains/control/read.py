"""Reads the tables of a case into a plant and its inputs; every mistake is a `CaseError`. The
tables of a plant are made from its description.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from pydantic import Field

from snapo.case.error import CaseError, nearest
from snapo.case.given import positions
from snapo.case.plausible import CaseFiles, Plausible, checked_numbers, implausible
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import (
    EvaluationKey,
    EvaluationTable,
    FollowingTable,
    ObjectiveKey,
    ObjectiveTable,
    TrainingKey,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
)
from snapo.case.table import LARGEST, CaseTable, Title, doc, parse

from .inputs import flat, make_inputs
from .kinds import KINDS, PlantKind, PlantParameter
from .records import ControlCase

Width = Annotated[int, Field(ge=1, le=4096)]
Widths = Annotated[list[Width], Field(min_length=1, max_length=8)]
MatrixRows = list[list[float]]
PositiveOrNone = Annotated[float, Field(gt=0)] | None


def _whole_number(meaning: str, low: int, high: int, note: str) -> Any:
    """An optional key whose value is a whole number from `low` to `high`."""
    return doc(meaning, None, f"a whole number from {low} to {high:,}{note}", ge=low, le=high)


class ControlFile(CaseTable):
    """The whole file; the tables in it are read as records of other classes."""

    kind: str = doc("kind of the case")
    title: Title = ""
    plant: dict[str, Any] = doc("plant and its parameters", allowed="a table, [plant]")
    cost: dict[str, Any] = doc("weights of the parts of the cost of a step", {}, "a table, [cost]")
    start: dict[str, Any] = doc("initial states", {}, "a table, [start]")
    noise: dict[str, Any] = doc(
        "standard deviations of the disturbances in a step, by state", {}, "a table, [noise]"
    )
    measurement: dict[str, Any] = doc(
        "standard deviations of the errors of measurement, by state", {}, "a table, [measurement]"
    )
    policy: dict[str, Any] = doc("network of the policy", {}, "a table, [policy]")
    report: ReportKey
    objective: ObjectiveKey
    training: TrainingKey
    evaluation: EvaluationKey


class ControlPolicyTable(CaseTable):
    """`[policy]`: the network of the policy."""

    hidden: Widths | None = doc(
        "widths of the hidden layers",
        None,
        "a list of widths, [32, 32]; by default chosen from the problem",
    )
    memory: Literal["GRU", "Recent"] | None = doc(
        "memory of earlier observations", None,
        '"GRU" (a recurrent network) or "Recent" (the last observations); or omit the key',
    )  # fmt: skip
    steps: int | None = _whole_number(
        "number of last observations that the policy remembers",
        2,
        1000,
        ', the number of observations in a memory of type "Recent"',
    )


class PlantTable(CaseTable):
    """`[plant]`: the keys of every plant in addition to its parameters."""

    type: str = doc("type of the plant")
    horizon: int | None = _whole_number("number of steps of an episode", 1, 100_000, " of steps")
    clock: bool | None = doc("whether the policy observes the remaining time", None)


def plant_table(plant: type[PlantKind]) -> type[PlantTable]:
    """`[plant]` of one type."""
    kind: Any = (Literal[plant.type], doc("type of the plant"))
    fields = {"type": kind, **_fields(plant.parameters)}
    return pydantic.create_model("PlantTable", __base__=PlantTable, **fields)


def cost_table(plant: type[PlantKind]) -> type[CaseTable]:
    """`[cost]` of one type."""
    return pydantic.create_model("CostTable", __base__=CaseTable, **_fields(plant.weights))


def _fields(parameters: Mapping[str, PlantParameter]) -> dict[str, Any]:
    return {name: (_kind(item), _field(item)) for name, item in parameters.items()}


def _kind(parameter: PlantParameter) -> Any:
    if parameter.value is None:
        return MatrixRows
    return PositiveOrNone if parameter.positive else float | None


def _field(parameter: PlantParameter) -> Any:
    text = parameter.description
    if parameter.value is None:
        return doc(text, allowed=f"a list of rows: {text}")
    unit = parameter.unit if parameter.unit not in ("", "1") else ""
    above = " above 0" if parameter.positive else ""
    usual = "none" if math.isinf(parameter.value) else f"{parameter.value:g}"
    allowed = f"a number{above} ({text}{f', {unit}' * bool(unit)}; by default {usual})"
    default = {} if math.isinf(parameter.value) else {"default": parameter.value}
    meaning = f"{text}, in {unit}" if unit else text
    return doc(meaning, None, allowed, json_schema_extra=default)


class At(CaseTable):
    """A fixed initial state."""

    at: float | list[float] = doc("initial state", allowed="a number, or a list of them")


class UniformStart(CaseTable):
    """A uniformly distributed initial state between two numbers."""

    low: float = doc("smallest initial state", allowed="a number below high")
    high: float = doc("largest initial state", allowed="a number above low")


class NormalStart(CaseTable):
    """A normally distributed initial state with independent components."""

    mean: float | list[float] = doc(
        "mean of the initial state", allowed="a number, or a list of them"
    )
    deviation: float | list[float] = doc(
        "standard deviation of the initial state", allowed="a number above 0, or a list of them"
    )


FORMS = "a table: { at = 1 }, { low = -1, high = 1 } or { mean = 0, deviation = 1 }"
RANGES = (  # outside of which a number is likely to be in another unit
    Plausible(
        0.0, 25.2, "an angle is in radians; 180 degrees are 3.14 rad", unit="rad", by_size=True
    ),
    Plausible(0.0, 1e3, "an angular speed is in radians per second", unit="rad/s", by_size=True),
    Plausible(0.5, 30.0, "on Earth it is 9.81 m/s2", unit="m/s2", endings=("gravity",)),
    Plausible(1e-6, 1e4, "1 ms is 0.001 s", unit="s"),
    Plausible(1e-4, 1e4, "1 mm is 0.001 m", unit="m", by_size=True),
    Plausible(1e-4, 1e6, "1 g is 0.001 kg", unit="kg"),
)
BLIND = (
    "States are measured with errors, but the policy has no memory of earlier measurements; "
    '`[policy] memory = "GRU"` adds a memory.'
)


def formats() -> dict[str, Any]:
    """The tables of a case by name; those of the plants are made from their descriptions."""
    plants = KINDS.values()
    return {
        "": ControlFile,
        "plant": [plant_table(plant) for plant in plants],
        "cost": [cost_table(plant) for plant in plants],
        "start.*": (At, UniformStart, NormalStart),
        "policy": ControlPolicyTable,
        "report": ReportTable,
        "training": FollowingTable,
        "evaluation": EvaluationTable,
    }


def read_case(file: Path, data: Mapping[str, Any]) -> ControlCase:
    """Reads all tables, then checks that their numbers are consistent."""
    table, name = parse(ControlFile, data, str(file), ""), str(file)
    plant = _plant(table.plant, name)
    selected = parse(plant_table(plant), table.plant, name, "plant")
    cost = parse(cost_table(plant), table.cost, name, "cost")
    training = read_training(table.training, name, FollowingTable)
    evaluation = read_evaluation(table.evaluation, name)
    objective = read_objective(table.objective, name)
    check_window(training, [objective.kind], name)
    parse(ReportTable, table.report, name, "report")
    policy = parse(ControlPolicyTable, table.policy, name, "policy")
    _check_policy(policy, name)
    parameters = {key: getattr(selected, key) for key in plant.parameters}
    weights = {key: getattr(cost, key) for key in plant.weights}
    starts = read_starts(plant, table.start, name)
    noise = read_noise(plant, table.noise, name)
    blur = read_measurement(plant, table.measurement, name)
    inputs = make_inputs(plant, _given(parameters), _given(weights), starts, noise, blur)
    entries = [
        checked_numbers(entry, f"{group}.{key}")
        for group, entries in inputs.items()
        for key, entry in flat(entries)
    ]
    slips = implausible(entries, RANGES, CaseFiles(file, data)).values()
    for key, value, message in plant.faults(_values(inputs)):
        raise CaseError(name, key, value, message)
    return ControlCase(
        file=file,
        notes=(*([BLIND] if blur and policy.memory is None else []), *slips),
        title=table.title or plant.description,
        kind=plant,
        horizon=selected.horizon,
        timer=selected.clock,
        inputs=inputs,
        objective=objective,
        objective_words=_words(objective),
        hidden=None if policy.hidden is None else tuple(policy.hidden),
        memory=policy.memory,
        window=policy.steps,
        training=training,
        evaluation=evaluation,
        positions=dict(_positions(data, inputs)),
    )


def _positions(data: Mapping[str, Any], inputs: Mapping[str, Any]) -> Iterator[tuple[str, tuple]]:
    """The pairs (name of an input, positions of its numbers); a start that the case omits has no
    entry."""
    for group, entries in inputs.items():
        for name, entry in flat(entries):
            first, *rest = name.split(".")
            value = data.get(group, {}).get(first)
            if group == "start" and value is None:
                continue
            locations = positions((group, first, *rest), np.shape(entry.value))
            if group == "noise" and np.ndim(value) < np.ndim(entry.value):  # a list: the diagonal
                size = len(entry.value)
                pairs = [(i, j) for i in range(size) for j in range(size)]
                locations = tuple((group, first, i) if i == j else None for i, j in pairs)
            yield f"{group}.{name}", locations


def _check_policy(table: ControlPolicyTable, name: str) -> None:
    if table.steps is not None and table.memory != "Recent":
        message = 'only memory = "Recent" has this number of observations'
        raise CaseError(name, "policy.steps", table.steps, message)
    if table.memory == "GRU" and table.hidden is not None and len(table.hidden) != 1:
        message = 'a "GRU" has one layer; write a list of one width, such as [16], or omit the key'
        raise CaseError(name, "policy.hidden", table.hidden, message)


def _plant(data: Mapping[str, Any], name: str) -> type[PlantKind]:
    kind = data.get("type")
    if isinstance(kind, str) and kind in KINDS:
        return KINDS[kind]
    text = ", ".join(f'"{item}"' for item in KINDS)
    if kind is None:
        raise CaseError(name, "plant.type", None, f"this key is missing; it is one of {text}")
    hint = f"; {nearest(kind, KINDS)}" if isinstance(kind, str) else ""
    raise CaseError(name, "plant.type", kind, f"it must be one of {text}{hint}")


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _values(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The inputs as plain arrays."""
    if not isinstance(inputs, Mapping):
        return np.asarray(inputs.value)  # pyright: ignore[reportReturnType]
    return {key: _values(item) for key, item in inputs.items()}


def _words(objective: ObjectiveTable) -> str:
    if objective.kind == "mean":
        return "mean reward of an episode"
    if objective.kind == "cvar":
        return f"mean of the worst {100 * (1 - (objective.level or 0.95)):.3g} % of rewards"
    return f"{objective.kind} of the reward"


def read_starts(plant: type[PlantKind], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: {"at"}, {"low", "high"} or {"mean", "deviation"}} of the states in the table."""
    _known(plant, data, name, "start")
    starts = {key: _start(value, name, f"start.{key}") for key, value in data.items()}
    for key, state in plant.states.items():
        if state.start is None and key not in starts:
            message = f"this key is missing; it is {FORMS}, or lists of numbers"
            raise CaseError(name, f"start.{key}", None, message)
    return starts


def read_noise(plant: type[PlantKind], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: standard deviations of the disturbance in a step} for the states in the table. A
    state of several numbers has a list, or the rows of a matrix that multiplies standard normals.
    """
    _known(plant, data, name, "noise")
    matrices = {}
    for key, value in data.items():
        numbers = _numbers(value, name, f"noise.{key}")
        if numbers.ndim < 2 and np.any(numbers < 0):
            raise CaseError(name, f"noise.{key}", value, "a standard deviation must be at least 0")
        matrices[key] = np.diag(numbers) if numbers.ndim == 1 else numbers
    return matrices


def read_measurement(plant: type[PlantKind], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: standard deviations of its measurement errors} for the states in the table."""
    _known(plant, data, name, "measurement")
    numbers = {}
    for key, value in data.items():
        numbers[key] = _numbers(value, name, f"measurement.{key}")
        if numbers[key].ndim > 1 or np.any(numbers[key] < 0):
            message = (
                "it must be a standard deviation of at least 0, or a list with one for each "
                "number of the state"
            )
            raise CaseError(name, f"measurement.{key}", value, message)
    return numbers


def _known(plant: type[PlantKind], data: Mapping[str, Any], name: str, table: str) -> None:
    for key, value in data.items():
        if key not in plant.states:
            message = f"the plant has no such state; {nearest(key, plant.states)}"
            raise CaseError(name, f"{table}.{key}", value, message)


def _start(value: Any, name: str, where: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise CaseError(name, where, value, f"it must be {FORMS}")
    keys = set(value)
    table = NormalStart if keys & {"mean", "deviation"} else At if "at" in keys else UniformStart
    read = parse(table, value, name, where)
    numbers = {
        key: _numbers(getattr(read, key), name, f"{where}.{key}") for key in table.model_fields
    }
    if isinstance(read, At):
        return numbers
    first, second = numbers.values()
    if first.shape != second.shape:
        raise CaseError(name, where, dict(value), "both lists must have the same length")
    if isinstance(read, UniformStart) and not read.low < read.high:
        raise CaseError(name, f"{where}.high", read.high, f"it must be a number above {read.low:g}")
    if isinstance(read, NormalStart) and np.any(numbers["deviation"] <= 0):
        message = (
            "all its numbers must be above 0; for an initial state without spread write { at = 1 }"
        )
        raise CaseError(name, f"{where}.deviation", value["deviation"], message)
    return numbers


def _numbers(value: Any, name: str, where: str) -> np.ndarray:
    """A number, a list or a matrix, as float64."""
    try:
        result = np.asarray(value)
    except ValueError:
        raise CaseError(name, where, value, "all rows must have the same length") from None
    if result.dtype.kind not in "fi" or result.ndim > 2 or not result.size:
        raise CaseError(
            name,
            where,
            value,
            "it must be a number, a list of numbers, or a list of rows of numbers",
        )
    if not np.all(np.isfinite(result)) or np.max(np.abs(result)) > LARGEST:
        raise CaseError(
            name,
            where,
            value,
            f"its numbers must be finite and at most {LARGEST:g} in absolute value",
        )
    return result.astype(np.float64)
