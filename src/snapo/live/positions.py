"""Where an input is in the files of a case: as its reader recorded it, else by trial.

A number that a `Quantity` declares has its position. Others are searched for in keys, columns, rows
of tables and new keys. A candidate counts when the case, written with other numbers there, is read
with exactly these numbers for the input and all others as before. So the case that a page writes
is the one that it valued, whatever the domain.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.problem.inputs import Input

from .files import Files, Key, Sheet, numbers_in, with_numbers

Put = Callable[[Files, np.ndarray], Files]
Guess = tuple[tuple[int, int], Put]  # the smaller, the more likely
SAME, NEW, LIKE = 0, 1, 2  # the numbers are there; a new key; as many numbers are there


def guesses(files: Files, name: str, values: Input) -> list[Put]:
    """Every guess, the most likely first."""
    results = [
        *_keys(files, name, values),
        *_rows(files, name, values),
        *_by_label(files, name, values),
        *_in_sheets(files, name, values),
        *_new_keys(files, name, values),
    ]
    return [put for _, put in sorted(results, key=lambda item: item[0])]


def _words(name: str) -> set[str]:
    return set(name.replace(".", "_").split("_"))


def _alike(name: str, key: Key) -> int:
    """Minus the number of terms that a path of keys shares with a name."""
    return -len(_words(name) & {word for part in key for word in str(part).split("_")})


def _numbers(value: Any) -> np.ndarray | None:
    """The numbers of a leaf: a number, a quantity as a text, or a list of either."""
    if isinstance(value, str):
        number = value.split(" ")[0].rstrip("%")
        return None if numbers_in([number]) is None else np.array(float(number))
    if isinstance(value, list) and value and all(isinstance(item, str) for item in value):
        numbers = [_numbers(entry) for entry in value]
        return None if any(each is None for each in numbers) else np.array(numbers, float)
    try:
        numbers = np.asarray(value)
    except ValueError:
        return None
    return numbers.astype(float) if numbers.dtype.kind in "iuf" else None


def _texts(value: Any) -> bool:
    return isinstance(value[0] if isinstance(value, list) and value else value, str)


def _fits(numbers: np.ndarray, texts: bool, values: Input) -> bool:
    """Whether the numbers may be the input's: equal, or in another unit, which keeps a sign."""
    if texts and values.unit != "K":
        return np.array_equal(np.sign(numbers.ravel()), np.sign(values.value.ravel()))
    return texts or np.array_equal(numbers.ravel(), values.value.ravel())


def _keys(files: Files, name: str, values: Input) -> Iterator[Guess]:
    """Keys with as many numbers."""
    for key, value in files.leaves():
        numbers = _numbers(value)
        if numbers is None:
            continue
        texts, shape = _texts(value), np.shape(value)
        if numbers.ndim == 1 and values.value.shape == (numbers.size, numbers.size):
            numbers, shape = np.diag(numbers), values.value.shape  # a list instead of a matrix
        if numbers.size != values.value.size:
            continue
        rank = SAME if _fits(numbers, texts, values) else LIKE
        yield (rank, _alike(name, key)), partial(_put_value, key, texts, values.unit, shape)


def _rows(files: Files, name: str, inputs: Input) -> Iterator[Guess]:
    """A key in as many rows of an array of tables."""
    columns: dict[tuple[Key, Key], list[Key]] = {}
    for key, value in files.leaves():
        for i, part in enumerate(key):
            numbers = _numbers(value)
            if isinstance(part, int) and numbers is not None and numbers.size == 1:
                columns.setdefault((key[:i], key[i + 1 :]), []).append(key)
    for (before, after), keys in columns.items():
        if len(keys) != inputs.value.size or len(keys) < 2:
            continue
        values = [_at(files.tables, key) for key in keys]
        texts = _texts(values[0])
        numbers = np.array([_numbers(item) for item in values], float)
        rank = (SAME if _fits(numbers, texts, inputs) else LIKE, _alike(name, (*before, *after)))
        yield rank, partial(_put_each, keys, texts, inputs.unit)


def _by_label(files: Files, name: str, values: Input) -> Iterator[Guess]:
    """A table whose keys are labels of the input; a label without a key is nothing."""
    labels = values.names()
    if len(labels) < 2:
        return
    for path, table in tables(files.tables, ()):
        if not table or not set(table) <= set(labels):
            continue
        numbers = [_numbers(value) for value in table.values()]
        if all(number is not None and number.size == 1 for number in numbers):
            texts = _texts(next(iter(table.values())))
            put = partial(_put_labels, path, labels, texts, values.unit)
            yield (SAME, _alike(name, path)), put


def _new_keys(files: Files, name: str, values: Input) -> Iterator[Guess]:
    """Keys that the case leaves at their defaults, in tables and in rows of tables."""
    local = name.rpartition(".")[2]
    spoken = dict.fromkeys([local, *name.replace(".", "_").split("_")])
    for path, table in tables(files.tables, ()):
        for key in spoken:
            if key in table or values.value.size > 1:
                continue
            rank = (NEW, _alike(name, (*path, key)) - (key == local))
            for text in (True, False):
                yield rank, partial(_put_each, [(*path, key)], text, values.unit)
    for path, rows in _arrays(files.tables, ()):
        for key in spoken:
            if len(rows) == values.value.size and not any(key in row for row in rows):
                keys = [(*path, i, key) for i in range(len(rows))]
                rank = (NEW, _alike(name, (*path, key)) - (key == local))
                yield rank, partial(_put_each, keys, True, values.unit)


def tables(table: Mapping[str, Any], path: Key) -> Iterator[tuple[Key, Mapping[str, Any]]]:
    """Every table, those in tables and those in rows of tables."""
    yield path, table
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from tables(value, (*path, key))
        elif isinstance(value, list):
            for i, item in enumerate(value):
                if isinstance(item, Mapping):
                    yield from tables(item, (*path, key, i))


def _arrays(table: Mapping[str, Any], path: Key) -> Iterator[tuple[Key, list]]:
    """Every array of tables."""
    for inner, result in tables(table, path):
        for key, value in result.items():
            if isinstance(value, list) and value and isinstance(value[0], Mapping):
                yield (*inner, key), value


def _at(tables: Any, key: Key) -> Any:
    for part in key:
        tables = tables[part]
    return tables


def _written(number: float, text: bool, unit: str) -> float | str:
    """A number, or a quantity in the domain's own unit."""
    return number if not text or unit in ("", "1") else f"{number!r} {unit}"


def _put_value(
    key: Key, text: bool, unit: str, shape: tuple[int, ...], files: Files, requested: np.ndarray
) -> Files:
    if text:
        entries = [_written(number, True, unit) for number in requested.ravel().tolist()]
        return files.with_value(key, entries if shape else entries[0])
    numbers = requested.reshape(shape).tolist() if shape else float(requested.ravel()[0])
    return files.with_value(key, numbers)


def _put_each(
    keys: Sequence[Key], text: bool, unit: str, files: Files, requested: np.ndarray
) -> Files:
    for key, number in zip(keys, requested.ravel().tolist(), strict=True):
        files = files.with_value(key, _written(number, text, unit))
    return files


def _put_labels(
    path: Key, labels: Sequence[str], text: bool, unit: str, files: Files, requested: np.ndarray
) -> Files:
    table = dict(_at(files.tables, path))
    for label, number in zip(labels, requested.ravel().tolist(), strict=True):
        if number or label in table:
            table[label] = _written(number, text, unit)
    return files.with_value(path, table)


def _in_sheets(files: Files, name: str, values: Input) -> Iterator[Guess]:
    """Columns with as many numbers."""
    text = _words(name)
    for file, sheet in files.sheets.items():
        for column, header in enumerate(sheet.header):
            filled = [cell for cell in sheet.column(column) if cell]
            numbers = numbers_in(filled)
            if numbers is None or len(numbers) != values.value.size:
                continue
            spoken = {*header.split("_"), *file.rpartition(".")[0].split("_")}
            rank = SAME if np.array_equal(numbers, values.value.ravel()) else LIKE
            yield (rank, -len(text & spoken)), partial(_put_column, file, column)


def _put_column(file: str, column: int, files: Files, requested: np.ndarray) -> Files:
    sheet, left = files.sheets[file], iter(requested.ravel().tolist())
    rows = [
        [repr(next(left)) if i == column and cell else cell for i, cell in enumerate(row)]
        for row in sheet.rows
    ]
    return files.with_sheet(file, Sheet(sheet.header, rows, sheet.lines))


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

    - `of`: gives the inputs of a case by name, where the domain gives them; else they are found
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
                raise CaseError(name, "", None, "the case does not contain this number unchanged")
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
    """The numbers of an input, slightly larger or smaller; the same within a month of days."""
    value = values.value
    if np.any(value):
        return value * (1 + step)
    return value + step * (abs(values.move) if values.move else 1.0)
