"""Where an input stands in the files of a case: found by trying, proved by reading.

The readers of domains are free in where they take a number from, and none of them says it. A place
is a guess (`guesses.py`); it counts when the case, written with other numbers there, is read with
exactly these numbers under the input's name and all others as before. So what a page writes as a
case is what it valued, whatever the domain.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import Given
from snapo.problem.inputs import Input

from .files import Files
from .guesses import Put, guesses


def numbers_of(case: Any) -> dict[str, np.ndarray]:
    """{name: numbers} of everything given in the records of a case, whatever its domain."""
    return dict(_given(case, "", set()))


def _given(record: Any, name: str, seen: set[int]) -> Iterator[tuple[str, np.ndarray]]:
    if id(record) in seen:
        return
    if isinstance(record, Given):
        if record.values.size:
            yield record.name, record.values
    elif isinstance(record, Input):
        yield name, record.value
    elif isinstance(record, Mapping):
        seen.add(id(record))
        for key, each in record.items():
            yield from _given(each, str(key), seen)
    elif isinstance(record, tuple | list):
        seen.add(id(record))
        for each in record:
            yield from _given(each, name, seen)
    elif is_dataclass(record) and not isinstance(record, type):
        seen.add(id(record))
        for field in fields(record):
            yield from _given(getattr(record, field.name, None), field.name, seen)


Read = Callable[[Path, Mapping[str, Any]], Any]
Inputs = Callable[[Any], Mapping[str, Input]]
LITTLE = 2.0**-20  # relative, of the move by which a place is tried
MOST = 60  # places tried for one input


class Moved(NamedTuple):
    """A case with other numbers: its files, and its records as its domain reads them."""

    files: Files
    case: Any


class Places:
    """The places of a case's inputs; each is looked for when it is first needed.

    - `of`: gives the inputs of a case by name, where the domain says them; else they are found
      among its records.
    """

    def __init__(
        self, read: Read, files: Files, inputs: Mapping[str, Input], of: Inputs | None = None
    ):
        self.read, self.files, self.inputs, self.of = read, files, inputs, of
        self.base = self._numbers(self.again(files))
        self._known: dict[str, Put | None] = {}

    def moved(self, values: Mapping[str, np.ndarray], files: Files | None = None) -> Moved:
        """The case in which the inputs named have these values; `files`: another case to put them
        into.

        **Raises:** `CaseError` where the case's own reader refuses them, or an input has no place
        in its files.
        """
        files = self.files if files is None else files
        for name, wanted in values.items():
            put = self.place(name)
            if put is None:
                what = "this input cannot be written into the files of the case"
                raise CaseError(name, "", None, what)
            files = put(files, wanted)
        case = self.again(files)
        found = self._numbers(case)
        for name, wanted in values.items():
            if name not in found or not np.array_equal(found[name].ravel(), wanted.ravel()):
                raise CaseError(name, "", None, "the case does not hold this number as it is")
        return Moved(files, case)

    def place(self, name: str) -> Put | None:
        """How numbers of an input are written; None where no place of it was found."""
        if name not in self._known:
            found = islice(guesses(self.files, name, self.inputs[name]), MOST)
            self._known[name] = next(filter(partial(self._holds, name), found), None)
        return self._known[name]

    def _numbers(self, case: Any) -> dict[str, np.ndarray]:
        if self.of is None:
            return numbers_of(case)
        return {name: given.value for name, given in self.of(case).items()}

    def again(self, files: Files) -> Any:
        """The case in these files, as its domain reads it."""
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as folder:
            return self.read(files.write(Path(folder)), files.tables)

    def _holds(self, name: str, put: Put) -> bool:
        """Whether numbers that are put there come back under this name, and nothing else moves."""
        for step in (LITTLE, -LITTLE):
            wanted = _little_moved(self.inputs[name], step)
            try:
                found = self._numbers(self.again(put(self.files, wanted)))
            except CaseError:
                continue
            same = name in found and all(
                np.array_equal(x.ravel(), (wanted if key == name else self.base[key]).ravel())
                for key, x in found.items()
                if key in self.base or key == name
            )
            if same:
                return True
        return False


def _little_moved(given: Input, step: float) -> np.ndarray:
    """The numbers of an input, a little larger or smaller; the same within a month of days."""
    value = given.value
    if np.any(value):
        return value * (1 + step)
    return value + step * (abs(given.move) if given.move else 1.0)
