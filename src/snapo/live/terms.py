"""Inputs in the user's units, with handles and the derivatives per handle; and the messages of
refused moves."""

import datetime
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError, Unquoted
from snapo.case.given import SourceNumbers
from snapo.problem.inputs import Input
from snapo.report.quantity import number, power, raised, unit_words
from snapo.solver.derivatives.interval import Interval, Reported, one_percent, plain
from snapo.solver.derivatives.table import Sensitivities
from snapo.solver.statistics import LEVEL, Estimate, critical

NONE: Mapping[str, SourceNumbers] = {}
MAX_DAYS = 62  # dates with separate handles; more of them are moved by month
MAX_ROWS = 60  # of one input in a table of derivatives
SHARE = 0.01  # of a number that does not say its `move`


def handles(entry: Input) -> list[tuple[str, list[int]]]:
    """The handles of an input: (label, positions) of the numbers that are moved together, such as
    the days of a month."""
    labels = entry.names()
    if len(labels) > MAX_DAYS and _days(labels):
        months: dict[str, list[int]] = {}
        for i, label in enumerate(labels):
            months.setdefault(label[:7], []).append(i)
        return list(months.items())
    return [(_written(label), [i]) for i, label in enumerate(labels)]


def _written(label: str) -> str:
    """A label with raised powers: "t^2" as "t²"."""
    return re.sub(r"\^(\d+)", lambda result: raised(result[1]), label)


def _days(labels: tuple[str, ...]) -> bool:
    try:
        return all(datetime.date.fromisoformat(label) for label in labels)
    except ValueError:
        return False


def described(name: str, entry: Input, slope: np.ndarray | None, source: str) -> dict[str, Any]:
    """An input for the page: its metadata, its numbers and, if they are known, the derivatives of
    the value with respect to them."""
    factor, trade_unit = own_unit(entry)
    return {
        "name": name,
        "words": entry.meaning,
        "group": entry.group or "other",
        "unit": entry.unit,
        "trade_unit": trade_unit,
        "factor": factor,
        "values": entry.value.ravel(),
        "shape": list(entry.value.shape),
        "handles": [{"label": label, "at": at} for label, at in handles(entry)],
        "move": entry.move,
        "slope": slope,
        "source": source,
    }


def own_unit(entry: Input) -> tuple[float, str]:
    """The number of display units in one unit of the input, and their name; 1 and "" if the field
    on the page uses the unit of the input."""
    # A temperature's other units have another zero, which a factor does not express.
    if not entry.display_unit or entry.unit == "K":
        return 1.0, ""
    return entry.display_factor, entry.display_unit


def slopes(table: Sensitivities | None, inputs: Mapping[str, Input]) -> dict[str, np.ndarray]:
    """The reported derivatives of the value with respect to the numbers of every input, flattened.
    If only the change along a bump of all numbers of an input is known, this change is divided
    among the numbers.
    """
    if table is None:
        return {name: np.zeros(entry.value.size) for name, entry in inputs.items()}
    return {name: _slopes(table.of(name)) for name in inputs}


def _slopes(derivative: Reported) -> np.ndarray:
    value, by = derivative.value.ravel(), derivative.by.ravel()
    if np.isfinite(value).all():
        return value
    complete, square = float(np.mean(derivative.total)), float(by @ by)
    return by * (complete / square) if square and np.isfinite(complete) else np.zeros(by.size)


class Deltas(NamedTuple):
    """The derivatives at moved inputs: the derivatives of the run, plus the change of the held
    derivatives from the run's inputs to the moved inputs, on the same paths.

    - `table`: the derivatives in the run, None if it has none.
    - `before`, `now`: {input: estimate} of the held derivatives at the run's inputs and at the
      moved inputs; they are equal if nothing moved.
    """

    table: Sensitivities | None
    before: Mapping[str, Estimate]
    now: Mapping[str, Estimate]

    def along(self, name: str, direction: np.ndarray, by: np.ndarray) -> Interval:
        """The derivative along a direction of an input, with its 95 % interval; `by`: the bump of
        the input.

        The error of the policy, and a reaction of the policy that held derivatives do not contain,
        are those of the run at the run's inputs.
        """
        now, before = self.now[name], self.before.get(name)
        available = self.table is not None and name in self.table.inputs
        if not available or before is None or before.blocks.shape != now.blocks.shape:
            return plain(now, by).along(direction)
        assert self.table is not None
        reported = self.table.of(name).along(direction)
        if now is before:
            return reported
        change, error = Estimate(now.blocks - before.blocks).along(direction)
        blocks = len(now.blocks)
        error = critical(blocks - 1, LEVEL) * error if blocks > 1 else 0.0
        sampling = float(np.hypot(reported.sampling, error))
        wider = sampling - reported.sampling
        return Interval(
            reported.value + change,
            reported.low + change - wider,
            reported.high + change + wider,
            sampling,
            reported.policy,
        )


def derivatives(
    deltas: Deltas, inputs: Mapping[str, Input], sources: Mapping[str, SourceNumbers] = NONE
) -> list[dict[str, Any]]:
    """A row for each input: the effect of its move, and the effect of one more unit at every point
    that can be dragged.

    `sources`: numbers from which inputs are made; their derivatives follow from those of the
    inputs.
    """
    return [_derivative(name, deltas, inputs[name], sources.get(name)) for name in inputs]


def usual(entry: Input) -> np.ndarray:
    """The standard move of every number of an input, in the shape of the input."""
    if entry.move is None:
        return SHARE * entry.value
    return np.full(entry.value.shape, entry.move)


def _derivative(
    name: str, deltas: Deltas, of: Input, source: SourceNumbers | None = None
) -> dict[str, Any]:
    bump, rows = one_percent(of), []

    def along(direction: np.ndarray) -> Interval:
        if source is None:
            return deltas.along(name, direction, bump)
        return deltas.along(source.input, source.matrix @ direction, source.matrix @ bump)

    for label, positions in handles(of)[:MAX_ROWS]:
        direction = np.zeros(of.value.size)
        direction[positions] = 1.0
        interval = along(direction.reshape(of.value.shape))
        rows.append({"label": label, "value": interval.value, **_limits(interval)})
    effect = along(usual(of))
    return {"input": name, "effect": effect.value, **_limits(effect), "rows": rows}


def _limits(interval: Interval) -> dict[str, float]:
    return {"low": interval.low, "high": interval.high}


MUCH = 1e9  # from which a power of ten reads better
MAXIMUM = 6  # moved inputs that are tried one by one


def no_value(
    moved: Mapping[str, np.ndarray], inputs: Mapping[str, Input], invalid: int, paths: int
) -> CaseError:
    """The message that refuses `moved` inputs with which `invalid` of `paths` paths are
    non-finite."""
    if not moved:
        message = f"with it, {_share(invalid, paths)} have no finite total, so there is no value"
        return CaseError("this choice", "", None, message)
    errors = [_no_value(name, inputs[name], new, invalid, paths) for name, new in moved.items()]
    first, *others = errors
    return CaseError(first.file, first.where, first.value, first.allowed, others)


def _no_value(name: str, values: Input, new: np.ndarray, invalid: int, paths: int) -> CaseError:
    where = np.flatnonzero(new.ravel() != values.value.ravel())
    i = int(where[np.argmax(np.abs(new.ravel() - values.value.ravel())[where])])
    message = (
        "it must be a number with which the simulator can calculate, such as the run's "
        f"{_said(values, values.value, i)}: here {_share(invalid, paths)} have no finite "
        "total, so there is no value"
    )
    position = values.names()[i] if new.size > 1 else ""
    return CaseError(name, position, Unquoted(_said(values, new, i)), message)


def _share(invalid: int, paths: int) -> str:
    return f"{'all' if invalid == paths else number(invalid, 0)} of the {number(paths, 0)} paths"


def _said(inputs: Input, values: np.ndarray, i: int) -> str:
    """A number of an input in the unit of its field on the page."""
    factor, local = own_unit(inputs)
    unit = local or ("" if inputs.unit == "1" else inputs.unit)
    displayed, unit = float(values.ravel()[i]) * factor, unit_words(unit)
    return f"{number(displayed) if abs(displayed) < MUCH else power(displayed, 2)} {unit}".rstrip()


def stopped(error: Exception, moved: Sequence[str], module: str | None) -> str:
    """The message for a calculation that stopped, because of an error in the user's `module` or in
    snapo.

    `moved`: names of the inputs and choices that differ from the run's.
    """
    text = f"{type(error).__name__}: {error}"[:500].rstrip(".")
    at = f" with {', '.join(moved[:MAXIMUM])} moved" if moved else ""
    frames = [
        (frame.f_code, line)
        for frame, line in walk_tb(error.__traceback__)
        if module and _of(str(frame.f_globals.get("__name__", "")), module)
    ]
    if not frames:
        return f"snapo could not calculate this{at}, because of an internal error: {text}."
    code, line = frames[-1]
    position = f"{Path(code.co_filename).name}, line {line}, {code.co_name}"
    return f"Your simulator stopped{at} ({position}): {text}."


def _of(name: str, module: str) -> bool:
    return name == module or name.startswith(f"{module}.")
