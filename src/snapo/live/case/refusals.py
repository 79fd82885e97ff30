"""Why numbers cannot be valued, in words for the page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from traceback import walk_tb

import numpy as np

from snapo.case.error import CaseError, Unquoted
from snapo.problem.inputs import Input
from snapo.report.quantity import number, power, unit_words

from ..terms import own_unit

MUCH = 1e9  # from which a power of ten reads better
MAXIMUM = 6  # moved inputs that are tried one by one


def no_value(
    moved: Mapping[str, np.ndarray], inputs: Mapping[str, Input], invalid: int, paths: int
) -> CaseError:
    """The refusal of `moved` inputs with which `invalid` of so many `paths` are not finite."""
    if not moved:
        message = f"{_share(invalid, paths)} come to no finite total, so there is no value"
        return CaseError("this choice", "", None, message)
    errors = [_no_value(name, inputs[name], new, invalid, paths) for name, new in moved.items()]
    first, *others = errors
    return CaseError(first.file, first.where, first.value, first.allowed, others)


def _no_value(name: str, values: Input, new: np.ndarray, invalid: int, paths: int) -> CaseError:
    where = np.flatnonzero(new.ravel() != values.value.ravel())
    i = int(where[np.argmax(np.abs(new.ravel() - values.value.ravel())[where])])
    message = (
        "allowed is a number with which the simulator can calculate, such as the run's "
        f"{_said(values, values.value, i)}: here {_share(invalid, paths)} come to no finite "
        "total, so there is no value"
    )
    position = values.names()[i] if new.size > 1 else ""
    return CaseError(name, position, Unquoted(_said(values, new, i)), message)


def _share(invalid: int, paths: int) -> str:
    return f"{'all' if invalid == paths else number(invalid, 0)} of its {number(paths, 0)} paths"


def _said(inputs: Input, values: np.ndarray, i: int) -> str:
    """A number of an input in the unit that its field on the page has."""
    factor, local = own_unit(inputs)
    unit = local or ("" if inputs.unit == "1" else inputs.unit)
    displayed, unit = float(values.ravel()[i]) * factor, unit_words(unit)
    return f"{number(displayed) if abs(displayed) < MUCH else power(displayed, 2)} {unit}".rstrip()


def stopped(error: Exception, moved: Sequence[str], module: str | None) -> str:
    """What ended a calculation: the user's own `module`, named as theirs with its words; or ours.

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
        return f"snapo could not calculate this{at}, by a mistake of its own: {text}."
    code, line = frames[-1]
    position = f"{Path(code.co_filename).name}, line {line}, {code.co_name}"
    return f"Your simulator stopped{at}; it says ({position}): {text}."


def _of(name: str, module: str) -> bool:
    return name == module or name.startswith(f"{module}.")
