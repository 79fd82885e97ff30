"""Makes the inputs of a plant: parameters, weights, initial state and disturbances, with their
units."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from snapo.problem.record import Input

from .kinds import MEASURED, PlantKind, PlantParameter, Variable

PlantInputs = dict[str, dict[str, Any]]
START_WORDS = {
    "at": "initial {}", "low": "lowest initial {}", "high": "highest initial {}",
    "mean": "mean initial {}", "deviation": "standard deviation of the initial {}",
}  # fmt: skip


def make_inputs(
    plant: type[PlantKind],
    parameters: Mapping[str, Any] | None = None,
    cost: Mapping[str, Any] | None = None,
    start: Mapping[str, Mapping[str, Any]] | None = None,
    noise: Mapping[str, Any] | None = None,
    measurement: Mapping[str, Any] | None = None,
) -> PlantInputs:
    """The inputs of a plant by group: "plant", "cost", "start", "noise" and "measurement". Groups
    that are omitted have the default numbers of the plant.

    - `start`: {state: {"at"}, {"low", "high"} or {"mean", "deviation"}}.
    - `noise`: {state: standard deviation of the disturbance in a step}. A matrix that multiplies
      standard normals, or one such matrix for every step, may replace the number.
    - `measurement`: {state: standard deviation of its measurement error}.

    **Raises:** `KeyError` for a name that the plant does not have.
    """
    starts = {name: state.start or {} for name, state in plant.states.items()} | dict(start or {})
    disturbed, noisy = noise or {}, measurement or {}
    for values in (starts, disturbed, noisy):
        if unknown := set(values) - set(plant.states):
            available = list(plant.states)
            raise KeyError(
                f"{plant.type}: there is no state {sorted(unknown)}; the states are {available}."
            )
    if defaulted := [name for name, item in starts.items() if not item]:
        raise KeyError(
            f"{plant.type}: there is no default start for {', '.join(defaulted)}; "
            f"specify it in `start`."
        )
    return {
        "plant": _each(plant.type, plant.parameters, parameters or {}, "plant"),
        "cost": _each(plant.type, plant.weights, cost or {}, "cost"),
        "start": {name: _start(plant.states[name], starts[name]) for name in plant.states},
        "noise": {name: _noise(plant.states[name], disturbed[name]) for name in disturbed},
        MEASURED: {name: _error(plant.states[name], noisy[name]) for name in noisy},
    }


def _each(
    plant: str, parameters: Mapping[str, PlantParameter], inputs: Mapping[str, Any], group: str
):
    if unknown := set(inputs) - set(parameters):
        raise KeyError(
            f"{plant}: there is no parameter {sorted(unknown)}; the parameters are "
            f"{list(parameters)}."
        )
    missing = [
        name for name, item in parameters.items() if item.value is None and name not in inputs
    ]
    if missing:
        raise KeyError(f"{plant}: give {', '.join(missing)}.")
    values = {name: inputs.get(name, entry.value) for name, entry in parameters.items()}
    return {
        name: Input(
            values[name],
            value.unit,
            meaning=value.description,
            group=group,
            move=_move(values[name]),
        )
        for name, value in parameters.items()
        if np.all(np.isfinite(values[name]))
    }


def _start(state: Variable, values: Mapping[str, Any]) -> dict[str, Input]:
    return {
        key: Input(
            value, state.unit, meaning=START_WORDS[key].format(state.description), group="start",
            move=_move(value),
        )
        for key, value in values.items()
    }  # fmt: skip


def _noise(state: Variable, value: Any) -> Input:
    text = f"standard deviation of the disturbance of the {state.description} in a step"
    return Input(value, state.unit, meaning=text, group="disturbance", move=_move(value))


def _error(state: Variable, value: Any) -> Input:
    text = f"standard deviation of the error with which the {state.description} is measured"
    return Input(value, state.unit, meaning=text, group=MEASURED, move=_move(value))


def _move(value: Any) -> float | None:
    """The standard move of a number; a number of zero moves by 0.01 units instead of a
    percentage."""
    return 0.01 if not np.any(value) else None


def flat(inputs: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The pairs (name, input) of a group; inputs within a state have names such as "angle.mean"."""
    for key, entry in inputs.items():
        if isinstance(entry, Mapping):
            yield from ((f"{key}.{name}", input_) for name, input_ in flat(entry))
        else:
            yield key, entry
