"""Mistakes made from a format's own description: the tables that a domain checks its case against.

Every table that the reading of a good case goes through is found by listening to `parse`. For every
key of it, in the case or not, its annotation and its description say what is allowed, and so what
is not: another type, another sign, beyond the range in words, no number, missing, unknown, twice.
"""

import copy
import datetime
import math
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, get_args, get_origin

from snapo.case import table as tables
from snapo.case.load import load
from snapo.case.quantity import quantity_of
from snapo.case.table import CaseTable
from snapo.study import commands

CASE, UNKNOWN = "case.toml", "a_key_that_nobody_knows"
TEXT, ODD = "no such thing", {"nobody": 1}


class Wrong(NamedTuple):
    """A case with one mistake.

    - `name`: the place and the kind of mistake.
    - `file`, `content`: the file that is changed, and all of it; None removes it.
    - `named`: words that a message must have.
    """

    name: str
    file: str
    content: bytes | None
    names: tuple[str, ...]


class Place(NamedTuple):
    """A table of a good case: its description, its way from the top, and its name in messages."""

    table: type[CaseTable]
    path: tuple[str | int, ...]
    name: str


def places(asked: commands.CaseRequest) -> list[Place]:
    """Each kind of table that the case has, once, where it stands first."""
    _, data = load(asked.path)
    commands.load(asked)  # so that all modules are imported
    with _listening() as heard:
        commands.load(asked)
    found: dict[type[CaseTable], Place] = {}
    for table, name in heard:
        way = tuple(
            int(each) if each.isdigit() else each for each in re.findall(r"[^.\[\]]+", name)
        )
        if isinstance(inside(data, way, {}), dict):
            found.setdefault(table, Place(table, way, name))
    return list(found.values())


@contextmanager
def _listening() -> Iterator[list[tuple[type[CaseTable], str]]]:
    """(table, name) of every call of `parse`, under whatever module it is known."""
    heard, true = [], tables.parse

    def parse(table, data, file, name, *more):
        heard.append((table, name))
        return true(table, data, file, name, *more)

    users = [each for each in list(sys.modules.values()) if vars(each).get("parse") is true]
    for each in users:
        each.parse = parse  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield heard
    finally:
        for each in users:
            each.parse = true  # pyright: ignore[reportAttributeAccessIssue]


def wrong_keys(asked: commands.CaseRequest) -> Iterator[Wrong]:
    """Every mistake of every key, and each key that stands in the case written twice."""
    file, data = load(asked.path)
    for place in places(asked):
        yield _changed(data, place, UNKNOWN, 1, "unknown", (UNKNOWN,))
        for key, field in place.table.model_fields.items():
            key = field.alias or key
            here = inside(data, place.path, {})
            if field.is_required() and key in here:
                yield _changed(data, place, key, ..., "missing", (key,))
            for mistake, value in _values(field):
                yield _changed(data, place, key, value, mistake, (key,))
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    for number, line in enumerate(lines):
        key = re.match(r"(\w+) *=", line)
        if key and line.count("[") == line.count("]") and line.count("{") == line.count("}"):
            twice = "\n".join([*lines[: number + 1], *lines[number:]]).encode()
            yield Wrong(f"{key[1]}, line {number + 1}: duplicated", CASE, twice, (CASE, key[1]))


def _changed(data, place: Place, key: str, value: Any, mistake: str, named) -> Wrong:
    changed = copy.deepcopy(data)
    here = changed
    for each in place.path:
        here = here.setdefault(each, {}) if isinstance(here, dict) else here[each]
    if value is ...:
        del here[key]
    else:
        here[key] = value
    where = f"{place.name}.{key}" if place.name else key
    return Wrong(f"{where}: {mistake}", CASE, toml(changed).encode(), named)


def inside(data: Any, way: tuple[str | int, ...], other: Any = None) -> Any:
    """The value at the end of a way through tables and lists; `other` where there is none."""
    for each in way:
        try:
            data = data[each]
        except (KeyError, IndexError, TypeError):
            return other
    return data


def _values(field) -> Iterator[tuple[str, Any]]:
    """(mistake, value) of all that the annotation and the description of a key rule out."""
    known, words = types_of(field), field.description or ""
    open_ = Any in known
    number = bool({int, float} & known) or open_
    if bool not in known:
        yield "a truth value", True
    if not {int, float} & known and not open_:
        yield "a number", 12.5
    if dict not in known and not open_:
        yield "a table", ODD
    if list not in known and not open_:
        yield "a list", [TEXT, TEXT]
    if datetime.date not in known:
        yield "a date", datetime.date(2025, 1, 1)
    if str not in known or number or Literal in known or "name of a CSV" in words:
        yield "text", TEXT
        yield "no text", ""
    if str in known and not number:
        yield "a size", "long " * 200_000
    if number:
        yield "not a number", math.nan
        yield "infinite", -math.inf
        yield "a size", -1e300
        yield "a whole size", 10**40
        yield "a unit", "12 candela * ampere"
    if {int, float} & known:
        yield from (("a sign or a range", value) for value in _beyond(words))
    if int in known and float not in known and list not in known:
        yield "a fraction", 2.5


def _beyond(words: str) -> set[float]:
    """Numbers just outside of the range that a description promises."""
    found: set[float] = set()
    words = re.sub(r"(?<=\d),(?=\d{3})", "", words)  # 1,000 is one number
    for low in re.findall(r"(?:at least|from) (-?[\d.]+\d|\d)", words):
        found.add(float(low) - 1)
    for low in re.findall(r"(-?[\d.]+\d|\d),? or more", words):
        found.add(float(low) - 1)
    for low in re.findall(r"above (-?[\d.]+\d|\d)", words):
        found |= {float(low), float(low) - 1}
    for low, high in re.findall(r"between (-?[\d.]+\d|\d) and (-?[\d.]+\d|\d)", words):
        found |= {float(low) - 1, float(low), float(high), float(high) + 1}
    for _, high in re.findall(r"from (-?[\d.]+\d|\d) to (-?[\d.]+\d|\d)", words):
        found.add(float(high) + 1)
    for high in re.findall(r"(?:at most|and below) (-?[\d.]+\d|\d)", words):
        found.add(float(high) + 1)
    return {int(each) if each == int(each) else each for each in found}


def types_of(field) -> set[Any]:
    """The plain types that a value of a key may have."""
    quantity = quantity_of(field)
    if quantity is None:
        return allowed_types(field.annotation)
    return {int, float, str} if quantity.by else {int, float}


def allowed_types(annotation: Any) -> set[Any]:
    """The plain types that a value may have; `Any` and `Literal` stand for themselves."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation is Any or origin is Literal:
        return {Literal, *map(type, inner)} if origin is Literal else {Any}
    if origin in (list, dict):
        return {origin}
    if isinstance(annotation, type):
        if issubclass(annotation, CaseTable):
            return {dict}
        return {int, float} if annotation is float else {annotation}
    if not inner:
        return {annotation}
    first = inner[:1] if hasattr(annotation, "__metadata__") else inner
    return set().union(*map(allowed_types, first))


def toml(value: Any, top: bool = True) -> str:
    """Parsed tables as TOML, a line for each key at the top."""
    if isinstance(value, dict):
        pairs = [f"{_key(key)} = {toml(each, False)}" for key, each in value.items()]
        return "\n".join([*pairs, ""]) if top else "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml(each, False) for each in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + SPECIAL.sub(_escaped, value) + '"'
    return value.isoformat() if isinstance(value, datetime.date) else repr(value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else toml(key)


SPECIAL = re.compile(r'["\\\x00-\x1f]')


def _escaped(character: re.Match[str]) -> str:
    return "\\" + character[0] if character[0] in '"\\' else f"\\u{ord(character[0]):04x}"
