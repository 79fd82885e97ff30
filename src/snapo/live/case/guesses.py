"""Where an input may stand in the files of a case: keys, columns, rows of tables, new keys.

A guess is cheap and may be wrong; `places.py` tries it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from snapo.problem.inputs import Input

from .files import Files, Key, Sheet, numbers_in

Put = Callable[[Files, np.ndarray], Files]
Guess = tuple[tuple[int, int], Put]  # the smaller, the likelier
SAME, NEW, LIKE = 0, 1, 2  # the numbers stand there; a new key; as many numbers stand there


def guesses(files: Files, name: str, given: Input) -> list[Put]:
    """Every guess, the likelier first."""
    found = [
        *_keys(files, name, given),
        *_rows(files, name, given),
        *_by_label(files, name, given),
        *_in_sheets(files, name, given),
        *_new_keys(files, name, given),
    ]
    return [put for _, put in sorted(found, key=lambda each: each[0])]


def _words(name: str) -> set[str]:
    return set(name.replace(".", "_").split("_"))


def _alike(name: str, key: Key) -> int:
    """Minus the number of words that a way shares with a name."""
    return -len(_words(name) & {word for part in key for word in str(part).split("_")})


def _numbers(value: Any) -> np.ndarray | None:
    """The numbers of a leaf: a number, a quantity as a text, or a list of either."""
    if isinstance(value, str):
        number = value.split(" ")[0].rstrip("%")
        return None if numbers_in([number]) is None else np.array(float(number))
    if isinstance(value, list) and value and all(isinstance(each, str) for each in value):
        found = [_numbers(each) for each in value]
        return None if any(each is None for each in found) else np.array(found, float)
    try:
        found = np.asarray(value)
    except ValueError:
        return None
    return found.astype(float) if found.dtype.kind in "iuf" else None


def _texts(value: Any) -> bool:
    return isinstance(value[0] if isinstance(value, list) and value else value, str)


def _fits(numbers: np.ndarray, texts: bool, given: Input) -> bool:
    """Whether the numbers may be the input's: equal, or in another unit, which keeps a sign."""
    if texts and given.unit != "K":
        return np.array_equal(np.sign(numbers.ravel()), np.sign(given.value.ravel()))
    return texts or np.array_equal(numbers.ravel(), given.value.ravel())


def _keys(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """Keys with as many numbers."""
    for key, value in files.leaves():
        numbers = _numbers(value)
        if numbers is None:
            continue
        texts, shape = _texts(value), np.shape(value)
        if numbers.ndim == 1 and given.value.shape == (numbers.size, numbers.size):
            numbers, shape = np.diag(numbers), given.value.shape  # a list that stands for a matrix
        if numbers.size != given.value.size:
            continue
        rank = SAME if _fits(numbers, texts, given) else LIKE
        yield (rank, _alike(name, key)), partial(_put_value, key, texts, given.unit, shape)


def _rows(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """A key in as many rows of an array of tables."""
    columns: dict[tuple[Key, Key], list[Key]] = {}
    for key, value in files.leaves():
        for i, part in enumerate(key):
            numbers = _numbers(value)
            if isinstance(part, int) and numbers is not None and numbers.size == 1:
                columns.setdefault((key[:i], key[i + 1 :]), []).append(key)
    for (before, after), keys in columns.items():
        if len(keys) != given.value.size or len(keys) < 2:
            continue
        values = [_at(files.tables, key) for key in keys]
        texts = _texts(values[0])
        numbers = np.array([_numbers(each) for each in values], float)
        rank = (SAME if _fits(numbers, texts, given) else LIKE, _alike(name, (*before, *after)))
        yield rank, partial(_put_each, keys, texts, given.unit)


def _by_label(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """A table whose keys are labels of the input; a label without a key is nothing."""
    labels = given.names()
    if len(labels) < 2:
        return
    for way, table in tables(files.tables, ()):
        if not table or not set(table) <= set(labels):
            continue
        numbers = [_numbers(value) for value in table.values()]
        if all(each is not None and each.size == 1 for each in numbers):
            texts = _texts(next(iter(table.values())))
            put = partial(_put_labels, way, labels, texts, given.unit)
            yield (SAME, _alike(name, way)), put


def _new_keys(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """Keys that the case leaves at their defaults, in tables and in rows of tables."""
    own = name.rpartition(".")[2]
    spoken = dict.fromkeys([own, *name.replace(".", "_").split("_")])
    for way, table in tables(files.tables, ()):
        for key in spoken:
            if key in table or given.value.size > 1:
                continue
            rank = (NEW, _alike(name, (*way, key)) - (key == own))
            for text in (True, False):
                yield rank, partial(_put_each, [(*way, key)], text, given.unit)
    for way, rows in _arrays(files.tables, ()):
        for key in spoken:
            if len(rows) == given.value.size and not any(key in row for row in rows):
                keys = [(*way, i, key) for i in range(len(rows))]
                rank = (NEW, _alike(name, (*way, key)) - (key == own))
                yield rank, partial(_put_each, keys, True, given.unit)


def tables(table: Mapping[str, Any], way: Key) -> Iterator[tuple[Key, Mapping[str, Any]]]:
    """Every table, those in tables and those in rows of tables."""
    yield way, table
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from tables(value, (*way, key))
        elif isinstance(value, list):
            for i, each in enumerate(value):
                if isinstance(each, Mapping):
                    yield from tables(each, (*way, key, i))


def _arrays(table: Mapping[str, Any], way: Key) -> Iterator[tuple[Key, list]]:
    """Every array of tables."""
    for inner, found in tables(table, way):
        for key, value in found.items():
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
    key: Key, text: bool, unit: str, shape: tuple[int, ...], files: Files, wanted: np.ndarray
) -> Files:
    if text:
        found = [_written(number, True, unit) for number in wanted.ravel().tolist()]
        return files.with_value(key, found if shape else found[0])
    numbers = wanted.reshape(shape).tolist() if shape else float(wanted.ravel()[0])
    return files.with_value(key, numbers)


def _put_each(
    keys: Sequence[Key], text: bool, unit: str, files: Files, wanted: np.ndarray
) -> Files:
    for key, number in zip(keys, wanted.ravel().tolist(), strict=True):
        files = files.with_value(key, _written(number, text, unit))
    return files


def _put_labels(
    way: Key, labels: Sequence[str], text: bool, unit: str, files: Files, wanted: np.ndarray
) -> Files:
    table = dict(_at(files.tables, way))
    for label, number in zip(labels, wanted.ravel().tolist(), strict=True):
        if number or label in table:
            table[label] = _written(number, text, unit)
    return files.with_value(way, table)


def _in_sheets(files: Files, name: str, given: Input) -> Iterator[Guess]:
    """Columns with as many numbers."""
    words = _words(name)
    for file, sheet in files.sheets.items():
        for column, header in enumerate(sheet.header):
            filled = [cell for cell in sheet.column(column) if cell]
            numbers = numbers_in(filled)
            if numbers is None or len(numbers) != given.value.size:
                continue
            spoken = {*header.split("_"), *file.rpartition(".")[0].split("_")}
            rank = SAME if np.array_equal(numbers, given.value.ravel()) else LIKE
            yield (rank, -len(words & spoken)), partial(_put_column, file, column)


def _put_column(file: str, column: int, files: Files, wanted: np.ndarray) -> Files:
    sheet, left = files.sheets[file], iter(wanted.ravel().tolist())
    rows = [
        [repr(next(left)) if i == column and cell else cell for i, cell in enumerate(row)]
        for row in sheet.rows
    ]
    return files.with_sheet(file, Sheet(sheet.header, rows, sheet.lines))
