"""The positions of a case's inputs in its files, which readers record so that new numbers can be
written. A case that is written is read again and must contain exactly these numbers. (If it
converts a number and no float gives exactly the new one, the nearest number is used.) Thus the case
that a page writes is the case that it valued, in every domain.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, FilePosition, NoPosition, SourceNumbers
from snapo.problem.inputs import Input

from .files import Files, readable, with_numbers


def numbers_of(case: Any) -> dict[str, np.ndarray]:
    """{name: numbers} of all inputs in the records of a case, whatever its domain."""
    return {name: _values(entry) for name, entry in inputs_in(case, "", set())}


def inputs_in(record: Any, name: str, visited: set[int]) -> Iterator[tuple[str, CaseInput | Input]]:
    """(name, numbers) of all inputs in a record, including the records, tuples, lists and mappings
    in it."""
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


class ChangedCase(NamedTuple):
    """A case with new numbers: its files, and its records as its domain reads them."""

    files: Files
    case: Any


class InputPositions:
    """The positions of a case's inputs.

    - `of`: returns the inputs of a case by name, if the domain defines such a function; otherwise
      they are collected from the records.
    - `case`: the records, if they have already been read.
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
        self.sources = sources_of(self.case)

    @property
    def movable(self) -> dict[str, Input]:
        """The inputs that a user moves; an input that is made from other numbers is replaced by
        these numbers."""
        return movable(self.inputs, self.case)

    @cached_property
    def recorded(self) -> dict[str, CaseInput]:
        """{name: numbers} of the inputs whose positions their reader recorded."""
        entries = dict(inputs_in(self.case, "", set()))
        recorded = {
            name: x
            for name, x in entries.items()
            if name in self.inputs and isinstance(x, CaseInput) and x.positions
        }
        for name, located in getattr(self.case, "positions", {}).items():
            x = self.inputs[name]
            index = np.arange(x.value.size)
            recorded[name] = CaseInput(
                name, x.value.ravel(), x.names(), x.unit, index, positions=located
            )
        recorded |= {name: source.numbers for name, source in self.sources.items()}
        # Two inputs of one file would both move.
        inputs_at = Counter(at for x in recorded.values() for at in set(x.positions))
        return {
            name: x
            for name, x in recorded.items()
            if all(_is_none(at) or inputs_at[at] == 1 for at in x.positions)
        }

    def case_at(self, values: Mapping[str, np.ndarray], files: Files | None = None) -> ChangedCase:
        """The case in which inputs have these values, {name: value}; `files`: the case into which
        the numbers are written, by default the case itself.

        **Raises:** `CaseError` if the reader of the case refuses them, or an input has no position
        in its files.
        """
        files = self.files if files is None else files
        for name, requested in values.items():
            if name not in self.recorded:
                message = "this input cannot be written into the files of the case"
                raise CaseError(name, "", None, message)
            files = with_numbers(files, self.recorded[name], requested)
            if name in self.sources:
                source = self.sources[name]
                files = with_numbers(files, source.implied, source.weights @ requested)
        case = self.reread(files)
        numbers = self._numbers(case)
        for name, requested in values.items():
            expected = readable(self.recorded[name], requested)
            if name not in numbers or not np.array_equal(numbers[name].ravel(), expected):
                raise CaseError(name, "", None, "the case does not contain this number unchanged")
        return ChangedCase(files, case)

    def _numbers(self, case: Any) -> dict[str, np.ndarray]:
        sources = {name: source.numbers.values for name, source in sources_of(case).items()}
        if self.of is None:
            return numbers_of(case) | sources
        return {name: values.value for name, values in self.of(case).items()} | sources

    def reread(self, files: Files) -> Any:
        """The case in these files, as its domain reads it."""
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as folder:
            return self.read(files.write(Path(folder)), files.tables)


def sources_of(case: Any) -> dict[str, SourceNumbers]:
    """{name: numbers} for the numbers of a case from which inputs are made."""
    return {source.numbers.name: source for source in getattr(case, "sources", ())}


def movable(inputs: Mapping[str, Input], case: Any) -> dict[str, Input]:
    """See `InputPositions.movable`."""
    sources = sources_of(case)
    made = {source.input for source in sources.values()}
    first = {name: source.numbers.input() for name, source in sources.items()}
    return first | {name: entry for name, entry in inputs.items() if name not in made}


def _is_none(position: FilePosition) -> bool:
    return position is None or isinstance(position, NoPosition)
