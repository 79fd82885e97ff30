"""`[start]`, `[noise]`, `[measurement]`: first state, disturbances, errors of measurement."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from snapo.case.error import CaseError, nearest
from snapo.case.table import LARGEST, parse

from .plants.plant import Plant
from .tables import At, NormalStart, UniformStart

FORMS = "a table: { at = 1 }, { low = -1, high = 1 } or { mean = 0, deviation = 1 }"


def read_starts(plant: type[Plant], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: {"at"}, {"low", "high"} or {"mean", "deviation"}} of the states that are named."""
    _known(plant, data, name, "start")
    starts = {key: _start(value, name, f"start.{key}") for key, value in data.items()}
    for key, state in plant.states.items():
        if state.start is None and key not in starts:
            message = f"this key is missing; it is {FORMS}, or lists of numbers"
            raise CaseError(name, f"start.{key}", None, message)
    return starts


def read_noise(plant: type[Plant], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: standard deviations of a step's disturbance} of the states that are named.

    Of a state of several numbers: a list, or the rows of a matrix that multiplies normals.
    """
    _known(plant, data, name, "noise")
    diags = {}
    for key, value in data.items():
        numbers = _numbers(value, name, f"noise.{key}")
        if numbers.ndim < 2 and np.any(numbers < 0):
            raise CaseError(name, f"noise.{key}", value, "a standard deviation is at least 0")
        diags[key] = np.diag(numbers) if numbers.ndim == 1 else numbers
    return diags


def read_measurement(plant: type[Plant], data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """{state: standard deviations of the errors with which it is seen} of the states named."""
    _known(plant, data, name, "measurement")
    numbers = {}
    for key, value in data.items():
        numbers[key] = _numbers(value, name, f"measurement.{key}")
        if numbers[key].ndim > 1 or np.any(numbers[key] < 0):
            message = (
                "allowed is a standard deviation of at least 0, or a list with one for each number"
            )
            raise CaseError(name, f"measurement.{key}", value, message)
    return numbers


def _known(plant: type[Plant], data: Mapping[str, Any], name: str, table: str) -> None:
    for key, value in data.items():
        if key not in plant.states:
            message = f"the plant has no such state; {nearest(key, plant.states)}"
            raise CaseError(name, f"{table}.{key}", value, message)


def _start(value: Any, name: str, where: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise CaseError(name, where, value, f"allowed is {FORMS}")
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
        raise CaseError(name, where, dict(value), "both must have the same number of numbers")
    if isinstance(read, UniformStart) and not read.low < read.high:
        raise CaseError(name, f"{where}.high", read.high, f"allowed is a number above {read.low:g}")
    if isinstance(read, NormalStart) and np.any(numbers["deviation"] <= 0):
        message = "allowed are numbers above 0; a first state without spread is { at = 1 }"
        raise CaseError(name, f"{where}.deviation", value["deviation"], message)
    return numbers


def _numbers(value: Any, name: str, where: str) -> np.ndarray:
    """A number, a list or a matrix, as float64."""
    try:
        result = np.asarray(value)
    except ValueError:
        raise CaseError(name, where, value, "all rows must have the same length") from None
    if result.dtype.kind not in "fi" or result.ndim > 2 or not result.size:
        raise CaseError(name, where, value, "allowed are numbers, a list or rows of them")
    if not np.all(np.isfinite(result)) or np.max(np.abs(result)) > LARGEST:
        raise CaseError(name, where, value, f"allowed are finite numbers of at most {LARGEST:g}")
    return result.astype(np.float64)
