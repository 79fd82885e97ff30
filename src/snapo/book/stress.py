"""The numbers of a case under a stress: inputs, and the quotes from which a curve is made."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import SourceNumbers
from snapo.problem.inputs import Input
from snapo.study.positions import sources_of

from .file import StressMove


def moved_numbers(
    case: Any, inputs: Mapping[str, Input], moves: Sequence[StressMove]
) -> dict[str, np.ndarray]:
    """{input, or numbers from which one is made: its numbers under the moves}; `inputs`: of the
    unstressed case.

    **Raises:** `CaseError` where a move fits no number.
    """
    values, sources = dict[str, np.ndarray](), sources_of(case)
    for move in moves:
        name = _source(move.key, sources)
        if name:
            value = values.get(name, sources[name].numbers.values)
            values[name] = _moved_source(sources[name], value, move)
        else:
            name = _input(move.key, inputs)
            value = values.get(name, inputs[name].value)
            values[name] = _moved(inputs[name], value, move)
    return values


def _input(key: str, inputs: Mapping[str, Input]) -> str:
    """The input of a key of the case: "market.forward_curve" is `forward_curve`, and
    "units.dryer.temperature" is `dryer.temperature`."""
    parts = key.split(".")
    for i in range(len(parts)):
        if (name := ".".join(parts[i:])) in inputs:
            return name
    raise CaseError("stress", key, None, f"allowed is one of {', '.join(inputs)}")


def _moved(entry: Input, value: np.ndarray, move: StressMove) -> np.ndarray:
    """The numbers of an input under a stress; `when`: where its labels begin with a date within."""
    if move.when is None:
        return value * move.scale + move.shift
    first, last = (day.isoformat() for day in move.when)
    labels = np.array([str(label)[:10] for label in entry.names()])
    inside = np.array([first[: len(x)] <= x <= last[: len(x)] for x in labels]).reshape(value.shape)
    if not inside.any():
        raise CaseError("stress", move.key, None, f"none of its numbers lies in {first}/{last}")
    return np.where(inside, value * move.scale + move.shift, value)


def _source(key: str, sources: Mapping[str, SourceNumbers]) -> str:
    """The numbers from which an input is made, of "market.quotes" and "market.quotes.2026-Q1"; ""
    of other keys."""
    return next((name for name in sources if f".{name}." in f".{key}."), "")


def _moved_source(source: SourceNumbers, value: np.ndarray, move: StressMove) -> np.ndarray:
    """Quotes under a stress: that of the product at the end of the key, else all; `when`: those
    whose days all lie within."""
    name, labels = source.numbers.name, source.numbers.labels
    label = f".{move.key}.".partition(f".{name}.")[2].removesuffix(".")
    inside = np.array([label in ("", x) for x in labels])
    if not inside.any():
        allowed = f"allowed is one of {', '.join(labels)}"
        raise CaseError("stress", move.key, None, f"no such number is free; {allowed}")
    if move.when is not None:
        first, last = move.when
        inside &= [first <= begins and ends <= last for begins, ends in source.periods]
        if not inside.any():
            message = f"none of its numbers has all of its days in {first}/{last}"
            raise CaseError("stress", move.key, None, message)
    return np.where(inside, value * move.scale + move.shift, value)
