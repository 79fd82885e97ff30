"""Keys of a case with a list of allowed values: words and switches, moved by a menu.

Of a key that stands in the case, no reader says which words it knows until it is asked for another
one: then its refusal lists them. A key that the case leaves at its default is known from the
formats of the tables that are checked while the case is read. Each value is tried; one that the
case cannot have as it stands is not offered.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from snapo.case.error import CaseError
from snapo.case.table import watching

from .files import Files, Key, numbers_in
from .guesses import tables

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
        owner, rest = capital(_spaced(key[at])), key[at + 1 :]
    else:
        owner, rest = "", key
    if len(rest) > 1 and rest[-1] == "kind":
        rest = rest[:-1]
    said = ", ".join(map(_spaced, rest))
    return f"{owner}: {said}" if owner else capital(said)


def capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _spaced(part: str | int) -> str:
    return str(part).replace("_", " ")


def _row(tables: Any, way: Key) -> str:
    """The name that a row of an array of tables gives itself, else "Parameter 2"."""
    for part in way:
        tables = tables[part]
    named = [tables[key] for key in OWN if isinstance(tables.get(key), str) and tables[key]]
    *_, table, place = way
    return named[0] if named else f"{capital(_spaced(table)).removesuffix('s')} {int(place) + 1}"


def _family(table: Any) -> bool:
    """Whether a table has nothing but named tables, as [units] with its units."""
    return isinstance(table, Mapping) and all(isinstance(x, Mapping) for x in table.values())


Tried = Callable[[Files], Any]
LEFT = ("title", "purpose", "kind", "report", "training", "evaluation", "policy", "goal")
NONE = "?"  # which is nobody's word
MOST_KEYS, MOST_WORDS = 60, 12
WORD = re.compile(r'"([^"\s][^"]{0,39})"')


class Choice(NamedTuple):
    """A key, its value in the run (where the case has none, the default), and all allowed ones.

    `title`: the key for people, "Granule size: distribution".
    """

    name: str
    key: Key
    value: str | bool
    allowed: Sequence[str | bool]
    title: str


def choices(files: Files, tried: Tried) -> list[Choice]:
    """Every key of the case that has more than one value; `tried` reads a case, or raises
    `CaseError`."""
    found = []
    defaults = {key: (value, others) for key, value, others in _defaults(files, tried)}
    stand = {key: (value, None) for key, value in _words(files)}
    for key, (value, others) in list({**stand, **defaults}.items())[:MOST_KEYS]:
        if others is None:
            others = [not value] if isinstance(value, bool) else _known(files, key, tried)
        allowed = [each for each in others if each != value and _holds(files, key, each, tried)]
        if allowed:
            name = ".".join(str(part + 1 if isinstance(part, int) else part) for part in key)
            found.append(Choice(name, key, value, [value, *allowed], title(files.tables, key)))
    return found


def chosen(files: Files, known: Sequence[Choice], wanted: Mapping[str, Any]) -> Files:
    """The case with other values of these keys.

    **Raises:** `CaseError` for a name that is no choice's, or a value that it cannot have.
    """
    by_name = {each.name: each for each in known}
    for name, value in wanted.items():
        choice = by_name.get(name)
        if choice is None:
            raise CaseError(name, "", None, "there is no such choice")
        if not any(type(each) is type(value) and each == value for each in choice.allowed):
            what = f"allowed is {' or '.join(map(str, choice.allowed))}"
            raise CaseError(name, "", value, what)
        files = files.with_value(choice.key, value)
    return files


def _words(files: Files) -> Iterator[tuple[Key, str | bool]]:
    """Keys whose value is a word or a switch: no quantity, no file, no sentence."""
    for way, table in tables(files.tables, ()):
        for key, value in table.items():
            if (way or (key,))[0] in LEFT:
                continue
            if isinstance(value, bool):
                yield (*way, key), value
            elif isinstance(value, str) and value not in files.sheets:
                plain = re.fullmatch(r"[A-Za-z][\w-]{0,39}", value)
                if plain and numbers_in([value]) is None:
                    yield (*way, key), value


def _defaults(files: Files, tried: Tried) -> Iterator[tuple[Key, str | bool, list[str | bool]]]:
    """Keys that the case leaves out, with their defaults and all values that their format names."""
    with watching() as seen:
        tried(files)
    places = {id(table): way for way, table in tables(files.tables, ())}
    by_name = {".".join(map(str, way)): way for way, _ in tables(files.tables, ())}
    for form, data, name in seen:
        way = places.get(id(data), by_name.get(name))  # a reader may hand on a copy
        if way is None and data == {} and name.isidentifier() and name not in files.tables:
            way = (name,)  # a table that the case leaves out altogether
        if way is None or (way and way[0] in LEFT):
            continue
        for field, about in form.model_fields.items():
            key, default = about.alias or field, about.default
            if key in data or (not way and key in LEFT):
                continue
            if isinstance(default, bool):
                yield (*way, key), default, [default, not default]
            elif isinstance(default, str):
                words = list(dict.fromkeys(WORD.findall(about.description or "")))
                if default in words and len(words) > 1:
                    yield (*way, key), default, [*words][:MOST_WORDS]


def _known(files: Files, key: Key, tried: Tried) -> list[str]:
    """The words in quotation marks of the refusal of a word that nobody knows."""
    try:
        tried(files.with_value(key, NONE))
    except CaseError as error:
        own = [each for each in (error, *error.others) if str(key[-1]) in each.where]
        words = [word for each in own for word in WORD.findall(each.allowed)]
        return list(dict.fromkeys(word for word in words if word != NONE))[:MOST_WORDS]
    return []  # any word will do: a name


def _holds(files: Files, key: Key, value: str | bool, tried: Tried) -> bool:
    try:
        tried(files.with_value(key, value))
    except CaseError:
        return False
    return True
