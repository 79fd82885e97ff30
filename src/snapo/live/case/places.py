"""Where an input stands in the files of a case: as its reader recorded it, else found by trying.

A number that a `Quantity` declares has its position. For others a place is a guess (`guesses.py`);
it counts when the case, written with other numbers there, is read with exactly these numbers under
the input's name and all others as before. So what a page writes as a case is what it valued,
whatever the domain.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.problem.inputs import Input

from .files import Files, with_numbers
from .guesses import Put, guesses


def numbers_of(case: Any) -> dict[str, np.ndarray]:
    """{name: numbers} of all inputs in the records of a case, whatever its domain."""
    return {name: _values(entry) for name, entry in inputs_in(case, "", set())}


def inputs_in(record: Any, name: str, visited: set[int]) -> Iterator[tuple[str, CaseInput | Input]]:
    """(name, numbers) of all inputs in a record, in its records, tuples, lists and mappings."""
    if isinstance(record, CaseInput | Input):
        if _values(record).size:
            yield getattr(record, "name", name), record
        return
    if id(record) in visited:
        return
    visited.add(id(record))
    if isinstance(record, Mapping):
        parts = [(item, str(key)) for key, item in record.items()]
    elif isinstance(record, tuple | list):
        parts = [(item, name) for item in record]
    elif is_dataclass(record) and not isinstance(record, type):
        parts = [(getattr(record, x.name, None), x.name) for x in fields(record)]
    else:
        parts = []
    for item, key in parts:
        yield from inputs_in(item, key, visited)


def _values(entry: CaseInput | Input) -> np.ndarray:
    return entry.values if isinstance(entry, CaseInput) else entry.value


ReadCase = Callable[[Path, Mapping[str, Any]], Any]
ReadInputs = Callable[[Any], Mapping[str, Input]]
LITTLE = 2.0**-20  # relative, of the move by which a place is tried
MAXIMUM = 60  # places tried for one input


class ChangedCase(NamedTuple):
    """A case with other numbers: its files, and its records as its domain reads them."""

    files: Files
    case: Any


class InputPositions:
    """The places of a case's inputs; one that its reader did not record is looked for when needed.

    - `of`: gives the inputs of a case by name, where the domain says them; else they are found
      among its records.
    - `case`: the records, where they are read already.
    """

    def __init__(
        self,
        read: ReadCase,
        files: Files,
        inputs: Mapping[str, Input],
        of: ReadInputs | None = None,
        case: Any = None,
    ):
        self.read, self.files, self.inputs, self.of = read, files, inputs, of
        self.case = self.reread(files) if case is None else case
        self._places: dict[str, Put | None] = {}

    @cached_property
    def base(self) -> dict[str, np.ndarray]:
        """{name: numbers} of the case."""
        return self._numbers(self.case)

    @cached_property
    def recorded(self) -> dict[str, CaseInput]:
        """{name: numbers} of the inputs whose positions their reader recorded."""
        entries = dict(inputs_in(self.case, "", set()))
        recorded = {
            name: x for name, x in entries.items() if isinstance(x, CaseInput) and x.positions
        }
        for name, located in getattr(self.case, "positions", {}).items():
            x = self.inputs[name]
            index = np.arange(x.value.size)
            recorded[name] = CaseInput(
                name, x.value.ravel(), x.names(), x.unit, index, positions=located
            )
        # Two inputs of one file would both move.
        inputs_at = Counter(at for x in recorded.values() for at in set(x.positions))
        return {
            name: x
            for name, x in recorded.items()
            if all(at is None or inputs_at[at] == 1 for at in x.positions)
        }

    def case_at(self, values: Mapping[str, np.ndarray], files: Files | None = None) -> ChangedCase:
        """The case in which the inputs named have these values; `files`: another case to put them
        into.

        **Raises:** `CaseError` where the case's own reader refuses them, or an input has no place
        in its files.
        """
        files = self.files if files is None else files
        for name, requested in values.items():
            put = self.writer(name)
            if put is None:
                message = "this input cannot be written into the files of the case"
                raise CaseError(name, "", None, message)
            files = put(files, requested)
        case = self.reread(files)
        numbers = self._numbers(case)
        for name, requested in values.items():
            if name not in numbers or not np.array_equal(numbers[name].ravel(), requested.ravel()):
                raise CaseError(name, "", None, "the case does not hold this number as it is")
        return ChangedCase(files, case)

    def writer(self, name: str) -> Put | None:
        """How numbers of an input are written; None where no place of it was found."""
        if name in self.recorded:
            return lambda files, numbers: with_numbers(files, self.recorded[name], numbers)
        if name not in self._places:
            candidates = islice(guesses(self.files, name, self.inputs[name]), MAXIMUM)
            self._places[name] = next(filter(partial(self._holds, name), candidates), None)
        return self._places[name]

    def _numbers(self, case: Any) -> dict[str, np.ndarray]:
        if self.of is None:
            return numbers_of(case)
        return {name: values.value for name, values in self.of(case).items()}

    def reread(self, files: Files) -> Any:
        """The case in these files, as its domain reads it."""
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as folder:
            return self.read(files.write(Path(folder)), files.tables)

    def _holds(self, name: str, put: Put) -> bool:
        """Whether numbers that are put there come back under this name, and nothing else moves."""
        for step in (LITTLE, -LITTLE):
            requested = _little_moved(self.inputs[name], step)
            try:
                numbers = self._numbers(self.reread(put(self.files, requested)))
            except CaseError:
                continue
            same = name in numbers and all(
                np.array_equal(x.ravel(), (requested if key == name else self.base[key]).ravel())
                for key, x in numbers.items()
                if key in self.base or key == name
            )
            if same:
                return True
        return False


def _little_moved(values: Input, step: float) -> np.ndarray:
    """The numbers of an input, a little larger or smaller; the same within a month of days."""
    value = values.value
    if np.any(value):
        return value * (1 + step)
    return value + step * (abs(values.move) if values.move else 1.0)
