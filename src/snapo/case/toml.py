"""Writes the tables of a case as TOML; Python reads that format and does not write it."""

import datetime
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

BARE = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)


def to_toml(data: Mapping[str, Any]) -> str:
    """Text that `tomllib` reads as `data`; numbers keep all their digits, without comments.

    **Raises:** `TypeError` for a value that TOML does not have.
    """
    return "\n".join(_table(data, "")).lstrip("\n") + "\n"


def one_value(value: Any) -> str:
    """One value as TOML writes it behind a key; a table is an inline one."""
    return _value(value)


def _table(data: Mapping[str, Any], name: str) -> Iterator[str]:
    """Plain keys first, then the tables below: after a header, keys belong to it."""
    tables = {key: value for key, value in data.items() if _is_table(value)}
    for key, value in data.items():
        if key not in tables:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in tables.items():
        full = f"{name}.{_key(key)}" if name else _key(key)
        if isinstance(value, Mapping):
            yield f"\n[{full}]"
            yield from _table(value, full)
        else:
            for item in value:
                yield f"\n[[{full}]]"
                yield from _table(item, full)


def _is_table(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    full = isinstance(value, list) and len(value) > 0
    return full and all(isinstance(item, Mapping) for item in value)


def _key(key: str) -> str:
    return key if BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    # JSON's escapes are TOML's, but for half of a surrogate pair and the character 127.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(key)} = {_value(entry)}" for key, entry in value.items())
        return "{ " + inside + " }" if inside else "{}"
    raise TypeError(f"to_toml: {value!r} has no form in TOML")
