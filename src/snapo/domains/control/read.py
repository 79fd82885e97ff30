"""From the tables of a case to the plant and its inputs; every mistake is a `CaseError`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError, nearest
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

from .inputs import make_inputs
from .plants.plant import Plant
from .plants.registry import TYPES
from .records import ControlCase
from .starts import read_noise, read_starts
from .tables import CaseTable, PolicyTable, cost_table, plant_table


def read_case(file: Path, data: Mapping[str, Any]) -> ControlCase:
    """Reads all tables, then looks whether their numbers fit together."""
    table, name = parse(CaseTable, data, str(file), ""), str(file)
    plant = _plant(table.plant, name)
    chosen = parse(plant_table(plant), table.plant, name, "plant")
    cost = parse(cost_table(plant), table.cost, name, "cost")
    training = read_training(table.training, name, FollowingTable)
    evaluation = read_evaluation(table.evaluation, name)
    objective = read_objective(table.objective, name)
    check_window(training, [objective.kind], name)
    hidden = parse(PolicyTable, table.policy, name, "policy").hidden
    parameters = {key: getattr(chosen, key) for key in plant.parameters}
    weights = {key: getattr(cost, key) for key in plant.weights}
    starts = read_starts(plant, table.start, name)
    noise = read_noise(plant, table.noise, name)
    inputs = make_inputs(plant, _given(parameters), _given(weights), starts, noise)
    for key, value, what in plant.faults(_values(inputs)):
        raise CaseError(name, key, value, what)
    return ControlCase(
        file=file,
        notes=(),
        title=table.title or plant.words,
        plant=plant(inputs, chosen.horizon, chosen.clock),
        inputs=inputs,
        objective=make_objective(objective, "reward"),
        objective_words=_words(objective),
        hidden=None if hidden is None else tuple(hidden),
        training=training,
        evaluation=evaluation,
    )


def _plant(data: Mapping[str, Any], name: str) -> type[Plant]:
    kind = data.get("type")
    if isinstance(kind, str) and kind in TYPES:
        return TYPES[kind]
    words = ", ".join(f'"{each}"' for each in TYPES)
    if kind is None:
        raise CaseError(name, "plant.type", None, f"this key is missing; it is one of {words}")
    hint = f"; {nearest(kind, TYPES)}" if isinstance(kind, str) else ""
    raise CaseError(name, "plant.type", kind, f"allowed is one of {words}{hint}")


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _values(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Plain arrays in place of inputs."""
    if not isinstance(inputs, Mapping):
        return np.asarray(inputs.value)  # pyright: ignore[reportReturnType]
    return {key: _values(each) for key, each in inputs.items()}


def _words(objective: ObjectiveTable) -> str:
    if objective.kind == "mean":
        return "mean reward of an episode"
    if objective.kind == "cvar":
        return f"mean of the worst {100 * (1 - (objective.level or 0.95)):.3g} % of rewards"
    return f"{objective.kind} of the reward"
