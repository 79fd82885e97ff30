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


def guesses(files: Files, name: str, values: Input) -> list[Put]:
    """Every guess, the likelier first."""
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
    """Minus the number of words that a way shares with a name."""
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
            numbers, shape = np.diag(numbers), values.value.shape  # a list that stands for a matrix
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
        writtens = [_written(number, True, unit) for number in requested.ravel().tolist()]
        return files.with_value(key, writtens if shape else writtens[0])
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
