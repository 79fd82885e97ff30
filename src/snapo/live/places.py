"""Where an input stands in the files of a case: found by trying, proved by reading.

The readers of domains are free in where they take a number from, and none of them says it. A place
is a guess (a key or a column with the same numbers); it counts when the case, written with other
numbers there, is read with exactly these numbers under the input's name and all others as before.
So what a page writes as a case is what it valued, whatever the domain.
"""

import datetime
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import Input

from .files import Files, Key, Sheet, numbers_in
from .numbers import numbers_of

Put = Callable[[Files, np.ndarray], Files]
Read = Callable[[Path, Mapping[str, Any]], Any]
LITTLE = 2.0**-20  # relative, of the move by which a place is tried
MOST = 60  # places tried for one input


class Moved(NamedTuple):
    """A case with other numbers: its files, and its records as its domain reads them."""

    files: Files
    case: Any


class Places:
    """The places of a case's inputs; each is looked for when it is first needed."""

    def __init__(self, read: Read, files: Files, inputs: Mapping[str, Input]):
        self.read, self.files, self.inputs = read, files, inputs
        self.base = numbers_of(self._again(files))
        self._known: dict[str, Put | None] = {}

    def moved(self, values: Mapping[str, np.ndarray]) -> Moved:
        """The case in which the inputs named have these values.

        **Raises:** `CaseError` where the case's own reader refuses them, or an input has no place
        in its files.
        """
        files = self.files
        for name, wanted in values.items():
            put = self.place(name)
            if put is None:
                what = "this input cannot be written into the files of the case"
                raise CaseError(name, "", None, what)
            files = put(files, wanted)
        case = self._again(files)
        found = numbers_of(case)
        for name, wanted in values.items():
            if not np.array_equal(found[name].ravel(), wanted.ravel()):
                raise CaseError(name, "", None, "the case does not hold this number as it is")
        return Moved(files, case)

    def place(self, name: str) -> Put | None:
        """How numbers of an input are written; None where no place of it was found."""
        if name not in self._known:
            self._known[name] = next(filter(partial(self._holds, name), self._guesses(name)), None)
        return self._known[name]

    def _again(self, files: Files) -> Any:
        with tempfile.TemporaryDirectory(prefix="snapo-live-") as folder:
            return self.read(files.write(Path(folder)), files.tables)

    def _holds(self, name: str, put: Put) -> bool:
        """Whether numbers that are put there come back under this name, and nothing else moves."""
        for step in (LITTLE, -LITTLE):
            wanted = _little_moved(self.inputs[name], step)
            try:
                found = numbers_of(self._again(put(self.files, wanted)))
            except CaseError:
                continue
            same = all(
                np.array_equal(x.ravel(), (wanted if key == name else self.base[key]).ravel())
                for key, x in found.items()
                if key in self.base
            )
            if same:
                return True
        return False

    def _guesses(self, name: str) -> Iterator[Put]:
        given = self.inputs[name]
        found = [*_in_tables(self.files, name, given), *_in_sheets(self.files, name, given)]
        ranked = sorted(found, key=lambda each: each[0])
        yield from (put for _, put in ranked[:MOST])


def _little_moved(given: Input, step: float) -> np.ndarray:
    """The numbers of an input, a little larger or smaller; the same within a month of days."""
    value = given.value
    if np.any(value):
        return value * (1 + step)
    return value + step * (abs(given.move) if given.move else 1.0)


Guess = tuple[tuple[int, int], Put]


def _in_tables(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """Keys with as many numbers, those with the same numbers and a like name first."""
    words = set(name.replace(".", "_").split("_"))
    for key, value in files.leaves():
        numbers = _numbers(value)
        if numbers is None or numbers.size != given.value.size:
            continue
        same = numbers.shape == given.value.shape or numbers.size == 1
        same = same and np.array_equal(numbers.ravel(), given.value.ravel())
        spoken = {word for part in key for word in str(part).split("_")}
        rank = (0 if same or isinstance(value, str) else 1, -len(words & spoken))
        yield rank, partial(_put_value, key, isinstance(value, str), given.unit, np.shape(value))
    if given.value.size == 1:
        own = name.rpartition(".")[2]
        for key, table in files.tables.items():
            if isinstance(table, Mapping) and own not in table:
                yield (2, 0), partial(_put_value, (key, own), False, "", ())


def _numbers(value: Any) -> np.ndarray | None:
    if isinstance(value, str):
        number = value.split(" ")[0].rstrip("%")
        return None if numbers_in([number]) is None else np.array(float(number))
    try:
        found = np.asarray(value)
    except ValueError:
        return None
    return found.astype(float) if found.dtype.kind in "iuf" else None


def _put_value(
    key: Key, text: bool, unit: str, shape: tuple[int, ...], files: Files, wanted: np.ndarray
) -> Files:
    if text:  # a quantity, in the domain's own unit
        number = float(wanted.ravel()[0])
        return files.with_value(key, number if unit in ("", "1") else f"{number!r} {unit}")
    numbers = wanted.reshape(shape).tolist() if shape else float(wanted.ravel()[0])
    return files.with_value(key, numbers)


def _in_sheets(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """Columns with as many numbers; of days, the rows of their months."""
    words = set(name.replace(".", "_").split("_"))
    for file, sheet in files.sheets.items():
        if _dates(given.names()) and len(sheet.header) == 2:
            yield (0, -9), partial(_put_dates, file, given.names())
        for column, header in enumerate(sheet.header):
            filled = [cell for cell in sheet.column(column) if cell]
            numbers = numbers_in(filled)
            if numbers is None or len(numbers) != given.value.size:
                continue
            same = np.array_equal(numbers, given.value.ravel())
            spoken = {*header.split("_"), *file.rpartition(".")[0].split("_")}
            rank = (0 if same else 1, -len(words & spoken))
            yield rank, partial(_put_column, file, column)


def _put_column(file: str, column: int, files: Files, wanted: np.ndarray) -> Files:
    sheet, left = files.sheets[file], iter(wanted.ravel().tolist())
    rows = [
        [repr(next(left)) if i == column and cell else cell for i, cell in enumerate(row)]
        for row in sheet.rows
    ]
    return files.with_sheet(file, Sheet(sheet.header, rows))


def _put_dates(file: str, labels: tuple[str, ...], files: Files, wanted: np.ndarray) -> Files:
    """One row for each month whose days are all alike, else one for each day."""
    months: dict[str, list[tuple[str, float]]] = {}
    for label, number in zip(labels, wanted.ravel().tolist()):
        months.setdefault(label[:7], []).append((label, number))
    rows = []
    for month, days in months.items():
        whole = len({number for _, number in days}) == 1 and len(days) > 1
        rows += [[month, repr(days[0][1])]] if whole else [[day, repr(x)] for day, x in days]
    sheet = files.sheets[file]
    return files.with_sheet(file, Sheet(sheet.header, rows))


def _dates(labels: tuple[str, ...]) -> bool:
    try:
        return all(datetime.date.fromisoformat(label) for label in labels)
    except ValueError:
        return False
