"""Writes the tables of a case as TOML, which Python's standard library can only read. It also
explains why a date or time does not exist, which Python's reader does not.
"""

import calendar
import datetime
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

BARE = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
NO_VALUE = re.compile(r'"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*')  # a text or a comment
CLOCK = r"(\d\d?):(\d\d)(?::(\d\d)(?:\.\d+)?)?(?:[Zz]|[+-]\d\d:\d\d)?"
MOMENT = re.compile(
    rf"(?<![\w.:+-])(?:(\d{{4}})-(\d\d?)-(\d\d?)(?:[Tt ]{CLOCK})?|{CLOCK}"
    r"|\d\d?([./])\d\d?\10\d{4}|\d{4}([./])\d\d?\11\d\d?)(?![\w.:+-])",
    re.ASCII,
)


def to_toml(data: Mapping[str, Any]) -> str:
    """The text that `tomllib` reads as `data`. Numbers keep all their digits; comments are lost.

    **Raises:** `TypeError` for a value that TOML does not have.
    """
    return "\n".join(_table(data, "")).lstrip("\n") + "\n"


def one_value(value: Any) -> str:
    """One value as TOML writes it after a key; a table is written inline."""
    return _value(value)


def impossible_moment(text: str) -> tuple[str, str] | None:
    """The first impossible date or time in values of TOML, and the reason; None if all exist."""
    bare = NO_VALUE.sub(lambda match: " " * len(match[0]), text)
    for match in MOMENT.finditer(bare):
        try:
            tomllib.loads(f"x = {match[0]}")
        except tomllib.TOMLDecodeError:
            reason = f": {fault}" if (fault := _fault(match)) else ""
            kind = "time" if match[7] else "date"
            allowed = "a date is YYYY-MM-DD and a time hh:mm:ss, without quotation marks"
            return match[0], f"this is not a {kind}{reason}; {allowed}"
    return None


def _fault(match: re.Match) -> str:
    """The reason why a date or time does not exist; "" if it exists but is written in another
    way."""
    year, month, day = (int(part or 1) for part in match.group(1, 2, 3))
    if not year:
        return "there is no year 0000"
    if not 1 <= month <= 12:
        return f"there is no month {match[2]}"
    if not 1 <= day <= (last := calendar.monthrange(year, month)[1]):
        return f"{calendar.month_name[month]} {year} has {last} days"
    for noun, part, last in zip(("hour", "minute", "second"), (4, 5, 6), (23, 59, 59)):
        number = match[part] or match[part + 3]
        if number and int(number) > last:
            return f"there is no {noun} {number}"
    return ""


def _table(data: Mapping[str, Any], name: str) -> Iterator[str]:
    """Writes plain keys first, then the tables within: keys after a header belong to that
    header."""
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
    raise TypeError(f"to_toml: {value!r} cannot be written in TOML")
