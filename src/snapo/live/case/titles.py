"""Keys of a case in words: what a choice belongs to, by its own name where it has one."""

from collections.abc import Mapping
from typing import Any

from .files import Key

OWN = ("title", "name", "label")  # keys by which the row of a table names itself


def title(tables: Mapping[str, Any], key: Key) -> str:
    """("parameters", 0, "distribution", "kind") as "Granule size: distribution", where the first
    row of `parameters` has this name; ("units", "mill", "kind") as "Mill: kind".
    """
    rows = [i for i, part in enumerate(key) if isinstance(part, int)]
    if rows:
        at = rows[-1]
        owner, rest = _row(tables, key[: at + 1]), key[at + 1 :]
    elif len(key) > 1:
        at = 1 if len(key) > 2 and _family(tables.get(str(key[0]))) else 0
        owner, rest = capital(_words(key[at])), key[at + 1 :]
    else:
        owner, rest = "", key
    if len(rest) > 1 and rest[-1] == "kind":
        rest = rest[:-1]
    said = ", ".join(map(_words, rest))
    return f"{owner}: {said}" if owner else capital(said)


def capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _words(part: str | int) -> str:
    return str(part).replace("_", " ")


def _row(tables: Any, way: Key) -> str:
    """The name that a row of an array of tables gives itself, else "Parameter 2"."""
    for part in way:
        tables = tables[part]
    named = [tables[key] for key in OWN if isinstance(tables.get(key), str) and tables[key]]
    *_, table, place = way
    return named[0] if named else f"{capital(_words(table)).removesuffix('s')} {int(place) + 1}"


def _family(table: Any) -> bool:
    """Whether a table has nothing but named tables, as [units] with its units."""
    return isinstance(table, Mapping) and all(isinstance(x, Mapping) for x in table.values())
