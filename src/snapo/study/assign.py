"""`--set contract.inventory=2000`: keys of a case that have another value for one run."""

import copy
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from snapo.case.error import CaseError, Unquoted, nearest
from snapo.case.table import DEEPEST, TOO_DEEP, is_deep

OPTION = "--set"


def assigned(data: Mapping[str, Any], assignments: Iterable[str]) -> tuple[dict, set[str]]:
    """A copy of the tables of a case with each "path=value" put in; and the paths.

    A path is made of keys; an element of an array is meant by its number from 0, or by its `name`.
    A value is written as in TOML. Whether a new key may stand there, the domain says.

    **Raises:** `CaseError` for a path that leads nowhere, and for a value that is not TOML.
    """
    changed, paths = copy.deepcopy(dict(data)), set()
    for text in assignments:
        path, value = _parsed(text)
        _put(changed, path, value)
        paths.add(path)
    return changed, paths


def _parsed(text: str) -> tuple[str, Any]:
    """The path and the value of one assignment."""
    path, sign, written = (part.strip() for part in text.partition("="))
    if not sign or not path or "" in path.split("."):
        what = "write it like contract.inventory=2000: a key of the case, =, and a value"
        raise CaseError(OPTION, "", text, what)
    try:
        found = tomllib.loads(f"value = {written}")
    except (tomllib.TOMLDecodeError, RecursionError):
        found = {}
    if path.count(".") >= DEEPEST or is_deep(found):
        raise CaseError(OPTION, "", path, TOO_DEEP)
    if list(found) != ["value"]:
        what = "this is not a value as TOML writes it: 2000, 0.5, true, 2027-04-01, [1, 2]"
        if written and not set(written) & set("\"'\n[]{}"):
            what = f"text needs quotation marks; in a shell: {OPTION} '{path}=\"{written}\"'"
        raise CaseError(OPTION, path, Unquoted(written or "nothing"), what)
    return path, found["value"]


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    """Sets one key; tables that are not there are made on the way."""
    *way, last = path.split(".")
    place: Any = data
    for i, key in enumerate(way):
        index, here = _index(place, key, path), ".".join(way[: i + 1])
        if isinstance(place, dict):
            place.setdefault(index, {})
        place = place[index]
        if not isinstance(place, dict | list):
            raise CaseError(OPTION, path, place, f"{here} is a value, not a table with keys")
    place[_index(place, last, path)] = value


def _index(place: dict | list, key: str, path: str) -> Any:
    """The key of a table; of an array the number of the element that `key` means."""
    if isinstance(place, dict):
        return key
    names = [each.get("name") if isinstance(each, dict) else None for each in place]
    if key in names:
        return names.index(key)
    if key.isascii() and key.isdigit() and int(key) < len(place):
        return int(key)
    numbers = f"the array has {len(place)} elements, numbered from 0"
    known = [str(name) for name in names if name is not None]
    what = f"{numbers}; {nearest(key, known)}" if known else numbers
    raise CaseError(OPTION, path, Unquoted(f"element {key}"), what)
