"""Stresses: their tables in the file of a book, and the numbers of a case under a stress. These
numbers are inputs, or the quotes from which a curve is made."""

import datetime
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.given import SourceNumbers
from snapo.case.table import CaseTable, TableContext, doc, parse
from snapo.case.toml import one_value
from snapo.problem.inputs import Input
from snapo.study.assign import assigned
from snapo.study.positions import sources_of

from .axes import CaseKey

SET_TWICE = "already set to a value; it cannot be scaled, shifted or set again"
PERIOD = re.compile(r"(\d{4}-\d{2}(?:-\d{2})?)/(\d{4}-\d{2}(?:-\d{2})?)", re.ASCII)


class BookStressTable(CaseTable):
    """`[[stress]]`"""

    name: str = doc("name of the stress", "", "a name")
    scale: dict[CaseKey, float] = doc(
        "factors on numbers of the cases", {}, 'factors, { "market.forward_curve" = 1.10 }'
    )
    shift: dict[CaseKey, float] = doc(
        "amounts added to numbers of the cases, in the unit of the number",
        {},
        'amounts, { "market.forward_curve" = 2.0 }',
    )
    set: dict[CaseKey, Any] = doc(
        "new values of keys", {}, 'new values of keys, { "contract.injection_cost" = 0.05 }'
    )
    when: str = doc(
        "period in which the numbers change, by default the whole time", "",
        'months or days, the last included: "2026-12/2027-02"',
    )  # fmt: skip
    table: str = doc(
        "table with one stress in each row",
        "",
        "the name of a CSV file with one stress in each row",
    )


@dataclass(frozen=True)
class StressMove:
    """One input under a stress: `value * scale + shift`, on the dates of `when`; or a key of the
    case with a new value.

    - `key`: a key of the case, "market.forward_curve".
    - `when`: first and last day of the move; None: all days.
    - `value`: the new value, as TOML writes it; "": the value in the case.
    """

    key: str
    scale: float = 1.0
    shift: float = 0.0
    when: tuple[datetime.date, datetime.date] | None = None
    value: str = ""


@dataclass(frozen=True)
class BookStress:
    """A stress: changed numbers for some inputs.

    - `labels`: {label of an axis: the text of its value}.
    - `file`, `where`: the position of the stress in the files of the book.
    """

    name: str
    moves: tuple[StressMove, ...]
    labels: Mapping[str, str] = field(default_factory=dict)
    file: str = field(default="", compare=False)
    where: str = field(default="", compare=False)


def read_stresses(file: Path, entries: Sequence[Mapping[str, Any]]) -> Iterator[BookStress]:
    """The stresses of the tables `[[stress]]` of a book.

    **Raises:** `CaseError` for every mistake in them.
    """
    for i, entry in enumerate(entries):
        where = f"stress[{i + 1}]"
        table = parse(BookStressTable, entry, str(file), where)
        if table.table:
            if others := [key for key in entry if key != "table"]:
                message = (
                    "a stress with a table may have no other key: the rows of the table contain "
                    "names and changes"
                )
                raise CaseError(str(file), f"{where}.{others[0]}", entry[others[0]], message)
            yield from _of_table(TableContext(file, where, []), table.table)
            continue
        if not table.name or not (table.scale or table.shift or table.set):
            message = (
                "a stress needs either a name and at least one of scale, shift and set, or a table"
            )
            raise CaseError(str(file), where, table.name or None, message)
        when = _period(str(file), f"{where}.when", table.when)
        keys = dict.fromkeys([*table.scale, *table.shift])
        if when is not None and not keys:
            message = (
                "a period can be used with scale or shift only; a key that is set has one "
                "value at all times"
            )
            raise CaseError(str(file), f"{where}.when", table.when, message)
        if twice := [key for key in keys if key in table.set]:
            raise CaseError(str(file), f"{where}.set", twice[0], f"this key is {SET_TWICE}")
        yield BookStress(
            table.name,
            (
                *(StressMove(key, value=one_value(value)) for key, value in table.set.items()),
                *(
                    StressMove(key, table.scale.get(key, 1.0), table.shift.get(key, 0.0), when)
                    for key in keys
                ),
            ),
            file=str(file),
            where=where,
        )


class MoveColumn(NamedTuple):
    """A column of a table of stresses: its name, its kind ("scale", "shift" or "set"), a key, and a
    period."""

    name: str
    kind: str
    key: str
    when: tuple[datetime.date, datetime.date] | None


def _of_table(context: TableContext, name: str) -> Iterator[BookStress]:
    """The stresses of a table, one in each row. Its columns are `name`, `scale KEY`, `shift KEY`,
    either with `@PERIOD`, and `set KEY`, whose values are written as for `--set`."""
    reference = FileReference(context, "table", name, below=True)
    rows = read_rows(reference, ("name",), with_keys=True)
    columns = [item for x in rows[0].cells if (item := _move_column(name, x)) is not None]
    for row in rows:
        moves = dict[tuple[str, Any], StressMove]()
        for column, kind, key, when in columns:
            if not row.cells[column]:
                continue
            move = moves.get((key, when), StressMove(key, when=when))
            if any(x == key and (kind == "set" or y.value) for (x, _), y in moves.items()):
                raise row.error(column, f"in this row the key is {SET_TWICE}")
            if kind == "set":
                move = replace(move, value=_toml_value(row, column))
            else:
                move = replace(move, **{kind: row.number(column)})
            moves[key, when] = move
        if not row.cells["name"]:
            raise row.error("name", "a stress must have a name")
        if not moves:
            raise row.error(
                "name", "a row with at least one of the columns scale KEY, shift KEY, set KEY"
            )
        where = f"line {row.line}"
        yield BookStress(row.label("name"), tuple(moves.values()), file=name, where=where)


def _move_column(file: str, name: str) -> MoveColumn | None:
    """The move that a column describes; None for a column that is ignored. A name that is almost
    that of a move is a mistake, because such a column would change no number."""
    kind, _, rest = name.partition(" ")
    kind, key = kind.lower(), rest.strip()
    if kind == "set" and key and "@" not in key:
        return MoveColumn(name, kind, key, None)
    if kind in ("scale", "shift"):
        key, at, period = (part.strip() for part in key.partition("@"))
        if key and bool(at) == bool(period):
            return MoveColumn(name, kind, key, _period(file, f"header, column {name}", period))
    moves = ("scale", "shift", "set", "when")
    if get_close_matches(kind, moves, n=1, cutoff=0.75) or {".", "@", "/"} & set(name):
        message = "columns are name, scale KEY, shift KEY, either with @PERIOD, and set KEY"
        example = '"scale market.forward_curve@2026-12/2027-02"'
        raise CaseError(file, "header", name, f"{message}, such as {example}")
    return None


def _toml_value(row: Row, column: str) -> str:
    """A value as TOML writes it."""
    text = row.label(column)
    try:
        value = assigned({}, [f"value={text}"])[0]["value"]
        if isinstance(value, float) and not isfinite(value):
            raise row.error(column, "it must be a finite number")
    except CaseError as error:
        raise row.error(column, error.allowed.partition("; in a shell")[0]) from None
    return text


def _period(file: str, where: str, text: str) -> tuple[datetime.date, datetime.date] | None:
    """The first and last day of a period such as "2026-12/2027-02"."""
    if not text:
        return None
    match = PERIOD.fullmatch(text)
    try:
        first, last = (_day(part, end) for part, end in zip(match.groups(), (False, True)))  # pyright: ignore
    except (AttributeError, ValueError):
        allowed = (
            'two months or days separated by a slash, the last one included: "2026-12/2027-02"'
        )
        raise CaseError(file, where, text, allowed) from None
    if last < first:
        raise CaseError(file, where, text, "the first day is after the last")
    return first, last


def _day(text: str, end: bool) -> datetime.date:
    if len(text) == 10:
        return datetime.date.fromisoformat(text)
    first = datetime.date.fromisoformat(f"{text}-01")
    if not end:
        return first
    next_month = (first.replace(day=28) + datetime.timedelta(days=4)).replace(day=1)
    return next_month - datetime.timedelta(days=1)


def moved_numbers(
    case: Any, inputs: Mapping[str, Input], moves: Sequence[StressMove]
) -> dict[str, np.ndarray]:
    """{name of an input, or of its source: its numbers under the moves}; `inputs`: the inputs of
    the unstressed case.

    **Raises:** `CaseError` if a move changes no number.
    """
    values, sources = dict[str, np.ndarray](), sources_of(case)
    for move in moves:
        name = _source(move.key, sources)
        if name:
            value = values.get(name, sources[name].numbers.values)
            values[name] = _moved_source(sources[name], value, move)
        else:
            name = _input(move.key, inputs)
            value = values.get(name, inputs[name].value)
            values[name] = _moved(inputs[name], value, move)
    return values


def check_tables(moves: Sequence[StressMove], tables: Mapping[str, Any]) -> None:
    """**Raises:** `CaseError` for a key whose table resembles a table of the case."""
    for move in moves:
        first, dot, _ = move.key.casefold().partition(".")
        names = [name.casefold() for name in tables]
        close = get_close_matches(first, names, n=1, cutoff=0.7)
        if dot and first not in names and close:
            message = f"the case has no table {first}; the nearest is {close[0]}"
            raise CaseError("stress", move.key, None, message)


def _input(key: str, inputs: Mapping[str, Input]) -> str:
    """The input of a key of the case: "market.forward_curve" is `forward_curve`, and
    "units.dryer.temperature" is `dryer.temperature`."""
    parts, names = key.casefold().split("."), {name.casefold(): name for name in inputs}
    for i in range(len(parts)):
        if name := names.get(".".join(parts[i:])):
            return name
    raise CaseError("stress", key, None, f"it must be one of {', '.join(inputs)}")


def _moved(entry: Input, value: np.ndarray, move: StressMove) -> np.ndarray:
    """The numbers of an input under a stress. With a period `when`, only those change whose label
    begins with a date in the period."""
    if move.when is None:
        return value * move.scale + move.shift
    first, last = (day.isoformat() for day in move.when)
    labels = np.array([str(label)[:10] for label in entry.names()])
    inside = np.array([first[: len(x)] <= x <= last[: len(x)] for x in labels]).reshape(value.shape)
    if not inside.any():
        raise CaseError("stress", move.key, None, f"none of its numbers lies in {first}/{last}")
    return np.where(inside, value * move.scale + move.shift, value)


def _source(key: str, sources: Mapping[str, SourceNumbers]) -> str:
    """The numbers from which an input is made, for keys such as "market.quotes" and
    "market.quotes.2026-Q1"; "" for other keys."""
    return next((name for name in sources if f".{name}." in f".{key}.".casefold()), "")


def _moved_source(source: SourceNumbers, value: np.ndarray, move: StressMove) -> np.ndarray:
    """Quotes under a stress: the quote of the product at the end of the key, or all quotes. With a
    period `when`, only those change whose days all lie in it."""
    name, labels = source.numbers.name, source.numbers.labels
    label = f".{move.key}.".casefold().partition(f".{name}.")[2].removesuffix(".")
    inside = np.array([label in ("", x.casefold()) for x in labels])
    if not inside.any():
        allowed = f"it must be one of {', '.join(labels)}"
        raise CaseError("stress", move.key, None, f"no number can be changed; {allowed}")
    if move.when is not None:
        first, last = move.when
        inside &= [first <= begins and ends <= last for begins, ends in source.periods]
        if not inside.any():
            message = f"none of its numbers has all of its days in {first}/{last}"
            raise CaseError("stress", move.key, None, message)
    return np.where(inside, value * move.scale + move.shift, value)
