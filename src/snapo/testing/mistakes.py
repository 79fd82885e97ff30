"""Makes every key of a case wrong in every common way; a reader must refuse the case with a clear
message, or read it.

`spoilt_keys` and `spoilt_files` iterate over the tables and the CSVs of a valid case, so that a new
key is tested at once. A mistake without any valid meaning (text for a number, NaN, an unknown key)
must be refused with a message that names its position; a change that may be valid (another sign, a
missing key) may be read, but must not raise any other error.

    complaints = refusals(read, folder, spoilt_keys(folder), scratch)
    assert not complaints, "\\n".join(complaints)
"""

import copy
import math
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.load import load

Read = Callable[[Path, dict[str, Any]], Any]
Route = tuple[str | int, ...]

UNKNOWN = "a_key_that_nobody_knows"


@dataclass(frozen=True)
class Mistake:
    """One mistake in a case.

    **Attributes:**

    - `name`: the position and the kind of the mistake, "contract.inventory: text".
    - `spoil`: changes the parsed TOML in place, or a file of the folder.
    - `names`: texts that the message must contain; empty if the changed case may be valid.
    """

    name: str
    spoil: Callable[[Path, dict[str, Any]], None]
    names: tuple[str, ...] = ()


def refusals(read: Read, folder: Path, mistakes: Iterable[Mistake], scratch: Path) -> list[str]:
    """A line for each mistake that `read` does not handle; the list is empty if it handles all of
    them.

    **Arguments:**

    - `read`: a domain's reader, `read(file, data) -> case`.
    - `folder`: the folder of a correct case, which is not changed.
    - `mistakes`: the mistakes of `spoilt_keys` or `spoilt_files`.
    - `scratch`: a folder for the copies with mistakes.
    """
    scratch.mkdir(parents=True, exist_ok=True)
    complaints = []
    for number, mistake in enumerate(mistakes):
        copied = Path(shutil.copytree(folder, scratch / str(number), ignore=_only_data))
        file, data = load(copied)
        mistake.spoil(copied, data)
        complaints.extend(_judge(read, file, data, mistake))
        shutil.rmtree(copied)
    return complaints


def _only_data(folder: str, names: list[str]) -> set[str]:
    """Ignores folders next to the case, such as its runs, which are not part of it."""
    return {name for name in names if (Path(folder) / name).is_dir()}


def _judge(read: Read, file: Path, data: dict[str, Any], mistake: Mistake) -> Iterator[str]:
    try:
        read(file, data)
    except CaseError as error:
        message = str(error)
        missing = [word for word in mistake.names if word not in message]
        if missing:
            yield f"{mistake.name}: {', '.join(missing)} not in the message: {message}"
    except Exception as error:
        yield f"{mistake.name}: {type(error).__name__} instead of a CaseError: {error}"
    else:
        if mistake.names:
            yield f"{mistake.name}: accepted"


# The tables of the TOML file.


def spoilt_keys(folder: Path, free: Iterable[str] = ()) -> Iterator[Mistake]:
    """Mistakes in every table and under every key of the case in `folder`.

    `free`: tables whose keys are names of the user's choice ("contents.initial"), where an
    unknown key is a new name.
    """
    _, data = load(folder)
    free = set(free)
    for path, value in _keys((), data):
        position = _place(path)
        if isinstance(value, dict):
            if position not in free:
                yield Mistake(f"{position}: unknown key", _put((*path, UNKNOWN), 1), (UNKNOWN,))
            if path:
                yield Mistake(
                    f"{position}: a number instead of a table", _put(path, 1.5), (_named(path),)
                )
        for kind, wrong, certain in _wrong(value):
            by_name = (_named(path),) if certain else ()
            yield Mistake(f"{position}: {kind}", _put(path, wrong), by_name)
        if path and not isinstance(path[-1], int):
            yield Mistake(f"{position}: left out", _leave_out(path))


def _keys(path: Route, value: Any) -> Iterator[tuple[Route, Any]]:
    """Every table, key and entry with its position, from the top down."""
    yield path, value
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _keys((*path, key), item)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _keys((*path, index), item)


def _wrong(value: Any) -> list[tuple[str, Any, bool]]:
    """(kind of mistake, the changed value, whether it is wrong in every position)."""
    if isinstance(value, dict | list):
        return [] if isinstance(value, dict) else [("a table for a list", {UNKNOWN: 1}, True)]
    results = [("a table", {UNKNOWN: 1}, True), ("an empty list", [], False)]
    if isinstance(value, bool):
        return [*results, ("text", "yes, please", True)]
    if isinstance(value, int | float):
        return [
            *results,
            ("text", "no such thing", True),
            ("not a number", math.nan, True),
            ("infinite", -math.inf, True),
            ("a truth value", True, True),
            ("another sign", -value, False),
            ("zero", 0 * value, False),
            ("a fraction", value + 0.5, False),
            ("huge", 10**12 * (value or 1), False),
        ]
    return [*results, ("a number", 12.5, False), ("no text", "", False)]


def _place(path: Route) -> str:
    return ".".join(map(str, path)) or "the case"


def _named(path: Route) -> str:
    """The word that a message must contain: the last key or, for an element of a list, the key of
    the list."""
    return str(next((item for item in reversed(path) if isinstance(item, str)), ""))


def _put(path: Route, value: Any) -> Callable[[Path, dict[str, Any]], None]:
    def spoil(folder: Path, data: dict[str, Any]) -> None:
        _inside(data, path)[path[-1]] = copy.deepcopy(value)

    return spoil


def _leave_out(path: Route) -> Callable[[Path, dict[str, Any]], None]:
    def spoil(folder: Path, data: dict[str, Any]) -> None:
        del _inside(data, path)[path[-1]]

    return spoil


def _inside(data: Any, path: Route) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data


# The files next to it.


def spoilt_files(folder: Path, labels: Iterable[str] = ()) -> Iterator[Mistake]:
    """Mistakes in every CSV next to the case in `folder`: in the file, its header and its columns.
    `labels`: columns of names in which any text is valid, even a text that looks like a number.
    """
    labels = set(labels)
    for file in sorted(folder.glob("*.csv")):
        name, lines = file.name, file.read_text(encoding="utf-8-sig").splitlines()
        head, *rows = [row for row, line in enumerate(lines) if line and line[0] != "#"]
        yield Mistake(
            f"{name}: missing", lambda where, _, name=name: (where / name).unlink(), (name,)
        )
        yield Mistake(f"{name}: empty", _write(name, b""), (name,))
        yield Mistake(f"{name}: not UTF-8", _write(name, b"\xff\xfe\xe9,\n"), (name,))
        yield Mistake(f"{name}: no rows", _write(name, lines[head].encode()), (name,))
        for column, title in enumerate(lines[head].split(",")):
            renamed = _line(lines, head, column, UNKNOWN)
            yield Mistake(f"{name}: unknown column for {title}", _write(name, renamed), (name,))
            for row in sorted({rows[0], rows[-1]}):
                position = f"{name}, line {row + 1}, {title}"
                for kind, cell, certain in _wrong_cells(lines[row].split(",")[column]):
                    certain = certain and (title not in labels or kind == "one cell more")
                    by_name = (name,) if certain else ()
                    spoilt = _line(lines, row, column, cell)
                    yield Mistake(f"{position}: {kind}", _write(name, spoilt), by_name)


def _wrong_cells(cell: str) -> list[tuple[str, str, bool]]:
    results = [("an empty cell", "", False), ("one cell more", cell + ",1", True)]
    try:
        value = float(cell)
    except ValueError:
        return [*results, ("another text", "no such thing", False)]
    results += [("text", "no such thing", True), ("not a number", "nan", True)]
    results += [("infinite", "1e999", True), ("a size", "1e300", True)]
    return [*results, ("another sign", f"{-value}", False)]


def _line(lines: list[str], row: int, column: int, cell: str) -> bytes:
    cells = lines[row].split(",")
    cells[column] = cell
    return "\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :], ""]).encode()


def _write(name: str, content: bytes) -> Callable[[Path, dict[str, Any]], None]:
    def spoil(folder: Path, data: dict[str, Any]) -> None:
        (folder / name).write_bytes(content)

    return spoil
