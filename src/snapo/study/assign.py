"""`--set contract.inventory=2000`: keys of a case that are changed for one run."""

import copy
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from snapo.case.error import CaseError, Unquoted, nearest
from snapo.case.load import DEEPEST, TOO_DEEP, is_deep
from snapo.case.toml import impossible_moment

OPTION = "--set"


def assigned(data: Mapping[str, Any], assignments: Iterable[str]) -> tuple[dict, set[str]]:
    """A copy of the tables of a case in which every "path=value" is assigned, and the list of
    paths. A path consists of keys; an element of an array is identified by its number from 0, or by
    its `name`. A value is written as in TOML. The domain decides whether a new key is allowed.

    **Raises:** `CaseError` for a path that does not exist, and for a value that is not TOML.
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
        message = "write an assignment as KEY=VALUE, such as contract.inventory=2000"
        raise CaseError(OPTION, "", text, message)
    try:
        data = tomllib.loads(f"value = {written}")
    except (tomllib.TOMLDecodeError, RecursionError):
        data = {}
    if path.count(".") >= DEEPEST or is_deep(data):
        raise CaseError(OPTION, "", path, TOO_DEEP)
    if list(data) != ["value"]:
        message = "this is not a valid value in TOML: 2000, 0.5, true, 2027-04-01, [1, 2]"
        if moment := impossible_moment(written):
            raise CaseError(OPTION, path, Unquoted(moment[0]), moment[1])
        if written and not set(written) & set("\"'\n[]{}"):
            message = f"a text needs quotation marks; in a shell: {OPTION} '{path}=\"{written}\"'"
        raise CaseError(OPTION, path, Unquoted(written or "nothing"), message)
    return path, data["value"]


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    """Sets one key, and creates missing tables."""
    *key_path, last = path.split(".")
    position: Any = data
    for i, key in enumerate(key_path):
        index, here = _index(position, key, path), ".".join(key_path[: i + 1])
        if isinstance(position, dict):
            position.setdefault(index, {})
        position = position[index]
        if not isinstance(position, dict | list):
            raise CaseError(OPTION, path, position, f"{here} is a value, not a table with keys")
    position[_index(position, last, path)] = value


def value_at(data: Mapping[str, Any], path: str) -> Any:
    """The value of a key of a case; None if the case does not have it."""
    position: Any = data
    for key in path.split("."):
        try:
            position = position[_index(position, key, path)]
        except (CaseError, KeyError, TypeError, AttributeError):
            return None
    return position


def key_as_in(data: Mapping[str, Any], key: str) -> str:
    """A key of a case in the spelling of its tables, if `key` differs from it only in capital
    letters. If the table has no such key, the result is in lower case, as names of columns are."""
    parts, position = list[str](), data
    for part in key.split("."):
        names = [name for name in position if name.casefold() == part.casefold()]
        name = part if part in position or len(names) > 1 else (names or [part.lower()])[0]
        parts.append(name)
        inner = position.get(name)
        position = inner if isinstance(inner, Mapping) else {}
    return ".".join(parts)


def _index(position: dict | list, key: str, path: str) -> Any:
    """The key of a table, or the number of the element of an array that `key` identifies."""
    if isinstance(position, dict):
        return key
    names = [item.get("name") if isinstance(item, dict) else None for item in position]
    if key in names:
        return names.index(key)
    if key.isascii() and key.isdigit() and int(key) < len(position):
        return int(key)
    numbers = f"the array has {len(position)} elements, which are numbered from 0"
    available = [str(name) for name in names if name is not None]
    message = f"{numbers}; {nearest(key, available)}" if available else numbers
    raise CaseError(OPTION, path, Unquoted(f"element {key}"), message)
