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
MOST = 6  # moved inputs that are tried one by one


def no_value(
    moved: Mapping[str, np.ndarray], inputs: Mapping[str, Input], bad: int, paths: int
) -> CaseError:
    """The refusal of `moved` inputs with which `bad` of so many `paths` are not finite."""
    if not moved:
        what = f"{_share(bad, paths)} come to no finite total, so there is no value"
        return CaseError("this choice", "", None, what)
    errors = [_no_value(name, inputs[name], new, bad, paths) for name, new in moved.items()]
    first, *others = errors
    return CaseError(first.file, first.where, first.value, first.allowed, others)


def _no_value(name: str, given: Input, new: np.ndarray, bad: int, paths: int) -> CaseError:
    where = np.flatnonzero(new.ravel() != given.value.ravel())
    i = int(where[np.argmax(np.abs(new.ravel() - given.value.ravel())[where])])
    what = (
        "allowed is a number with which the simulator can calculate, such as the run's "
        f"{_said(given, given.value, i)}: here {_share(bad, paths)} come to no finite "
        "total, so there is no value"
    )
    place = given.names()[i] if new.size > 1 else ""
    return CaseError(name, place, Unquoted(_said(given, new, i)), what)


def _share(bad: int, paths: int) -> str:
    return f"{'all' if bad == paths else number(bad, 0)} of its {number(paths, 0)} paths"


def _said(given: Input, values: np.ndarray, i: int) -> str:
    """A number of an input in the unit that its field on the page has."""
    factor, own = own_unit(given)
    unit = own or ("" if given.unit == "1" else given.unit)
    shown, unit = float(values.ravel()[i]) * factor, unit_words(unit)
    return f"{number(shown) if abs(shown) < MUCH else power(shown, 2)} {unit}".rstrip()


def stopped(error: Exception, moved: Sequence[str], module: str | None) -> str:
    """What ended a calculation: the user's own `module`, named as theirs with its words; or ours.

    `moved`: names of the inputs and choices that differ from the run's.
    """
    words = f"{type(error).__name__}: {error}"[:500].rstrip(".")
    at = f" with {', '.join(moved[:MOST])} moved" if moved else ""
    frames = [
        (frame.f_code, line)
        for frame, line in walk_tb(error.__traceback__)
        if module and _of(str(frame.f_globals.get("__name__", "")), module)
    ]
    if not frames:
        return f"snapo could not calculate this{at}, by a mistake of its own: {words}."
    code, line = frames[-1]
    place = f"{Path(code.co_filename).name}, line {line}, {code.co_name}"
    return f"Your simulator stopped{at}; it says ({place}): {words}."


def _of(name: str, module: str) -> bool:
    return name == module or name.startswith(f"{module}.")
