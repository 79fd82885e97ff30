"""Keys of a case with a list of allowed values: words and switches, moved by a menu.

Which words a key may have is declared in the table that it belongs to. Each is tried; one that the
case cannot have with its other keys is not offered.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from snapo.case.error import CaseError
from snapo.case.table import keys_of, recorded_tables

from .files import Files, Key
from .guesses import tables

OWN = ("title", "name", "label")  # keys by which the row of a table names itself


def title(tables: Mapping[str, Any], key: Key) -> str:
    """("parameters", 0, "distribution", "kind") as "Granule size: distribution", where the first
    row of `parameters` has this name; ("units", "mill", "kind") as "Mill: kind".
    """
    rows = [i for i, part in enumerate(key) if isinstance(part, int)]
    if rows:
        at = rows[-1]
        user, rest = _row(tables, key[: at + 1]), key[at + 1 :]
    elif len(key) > 1:
        at = 1 if len(key) > 2 and _family(tables.get(str(key[0]))) else 0
        user, rest = capital(_spaced(key[at])), key[at + 1 :]
    else:
        user, rest = "", key
    if len(rest) > 1 and rest[-1] == "kind":
        rest = rest[:-1]
    metadata = ", ".join(map(_spaced, rest))
    return f"{user}: {metadata}" if user else capital(metadata)


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _spaced(part: str | int) -> str:
    return str(part).replace("_", " ")


def _row(tables: Any, path: Key) -> str:
    """The name that a row of an array of tables gives itself, else "Parameter 2"."""
    for part in path:
        tables = tables[part]
    by_name = [tables[key] for key in OWN if isinstance(tables.get(key), str) and tables[key]]
    *_, table, position = path
    return (
        by_name[0]
        if by_name
        else f"{capital(_spaced(table)).removesuffix('s')} {int(position) + 1}"
    )


def _family(table: Any) -> bool:
    """Whether a table has nothing but named tables, as [units] with its units."""
    return isinstance(table, Mapping) and all(isinstance(x, Mapping) for x in table.values())


Tried = Callable[[Files], Any]
LEFT = ("title", "purpose", "kind", "report", "training", "evaluation", "policy", "goal")
MAX_KEYS, MAX_WORDS = 60, 12


class MenuChoice(NamedTuple):
    """A key, its value in the run (where the case has none, the default), and all allowed ones.

    `title`: the key for people, "Granule size: distribution".
    """

    name: str
    key: Key
    value: str | bool
    allowed: Sequence[str | bool]
    title: str


def choices(files: Files, bumped: Tried) -> list[MenuChoice]:
    """Every key of the case that has more than one value; `bumped` reads a case, or raises
    `CaseError`."""
    menus = []
    options = _options(files, bumped)
    stated = [key for key in _keys(files) if key in options]
    for key in [*stated, *(key for key in options if key not in stated)][:MAX_KEYS]:
        value, text = options[key]
        others = [word for word in text if word != value and _holds(files, key, word, bumped)]
        if others:
            name = ".".join(str(part + 1 if isinstance(part, int) else part) for part in key)
            menus.append(MenuChoice(name, key, value, [value, *others], title(files.tables, key)))
    return menus


def case_with(files: Files, available: Sequence[MenuChoice], requested: Mapping[str, Any]) -> Files:
    """The case with other values of these keys.

    **Raises:** `CaseError` for a name that is no choice's, or a value that it cannot have.
    """
    by_name = {item.name: item for item in available}
    for name, value in requested.items():
        choice = by_name.get(name)
        if choice is None:
            raise CaseError(name, "", None, "there is no such choice")
        if not any(type(entry) is type(value) and entry == value for entry in choice.allowed):
            message = f"allowed is {' or '.join(map(str, choice.allowed))}"
            raise CaseError(name, "", value, message)
        files = files.with_value(choice.key, value)
    return files


def _keys(files: Files) -> Iterator[Key]:
    """All keys of the case, in its order."""
    for path, table in tables(files.tables, ()):
        yield from ((*path, key) for key in table)


def _options(files: Files, bumped: Tried) -> dict[Key, tuple[str | bool, list[str | bool]]]:
    """{key: its value, or its default where the case leaves it out, and all that it may have}."""
    with recorded_tables() as read:
        bumped(files)
    paths = {id(table): key_path for key_path, table in tables(files.tables, ())}
    ways = set(paths.values())
    menus: dict[Key, tuple[str | bool, list[str | bool]]] = {}
    for table in read:
        path = paths.get(id(table.data), keys_of(table.name))  # a reader may hand on a copy
        left_out = table.data == {} and len(path) == 1 and path[0] not in files.tables
        if not (path in ways or left_out) or (path and path[0] in LEFT):
            continue
        for key, options in table.options.items():
            default = table.fields[key].default if key in table.fields else None
            value = table.data.get(key, default)
            text = [x for x in dict.fromkeys(options) if type(x) is type(value)][:MAX_WORDS]
            if value in text and len(text) > 1 and (path or key not in LEFT):
                menus[(*path, key)] = value, text
    return menus


def _holds(files: Files, key: Key, value: str | bool, bumped: Tried) -> bool:
    try:
        bumped(files.with_value(key, value))
    except CaseError:
        return False
    return True
