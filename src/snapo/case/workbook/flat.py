"""Nested tables as lines of (key, value), and back: `indexation.cap`, `reactions[0].name`."""

import datetime
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ..toml import one_value, to_toml

PART = re.compile(r'([A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*")((?:\[\d+\])*)(\.|$)', re.ASCII)
PLAIN = re.compile(r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]+")
LARGEST = 1e15  # whole numbers beyond lose digits in a spreadsheet
TEXT = "TOML"  # the word beside a value that is written as TOML


class Unreadable(ValueError):
    """A key or a value of a sheet that no case has: what is wrong with it."""


def lines(data: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
    """(key, value, "" or "TOML") of all plain values; a list or an odd value is TOML text."""
    for key, value in data.items():
        yield from _lines(_quoted(key), value)


def _lines(position: str, value: Any) -> Iterator[tuple[str, Any, str]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _lines(f"{position}.{_quoted(key)}", item)
    elif isinstance(value, list) and value and all(isinstance(x, Mapping) and x for x in value):
        for i, item in enumerate(value):
            yield from _lines(f"{position}[{i}]", item)
    elif _is_plain(value):
        yield position, value, ""
    else:
        yield position, one_value(value), TEXT


def _quoted(key: str) -> str:
    return to_toml({key: 0}).partition(" = 0")[0]


def is_kept(number: float) -> bool:
    """Whether sixteen digits, as many as openpyxl writes, are all of a number's."""
    return float(f"{number:.16g}") == number


def _is_plain(value: Any) -> bool:
    """Whether a cell of a spreadsheet holds this value as it is."""
    if isinstance(value, bool):
        return True
    if isinstance(value, int | float):
        return math.isfinite(value) and abs(value) < LARGEST and is_kept(value)
    if isinstance(value, str):
        odd = "_x" in value or value != value.strip()
        return bool(PLAIN.fullmatch(value)) and not odd and len(value) < 30_000
    day = isinstance(value, datetime.date) and not isinstance(value, datetime.datetime)
    return day and value.year >= 1901


def tables(result: Iterable[tuple[str, Any, str]]) -> dict[str, Any]:
    """The inverse of `lines`.

    **Raises:** `Unreadable` for a key that is none, stands there twice, or contradicts another.
    """
    data: dict[str, Any] = {}
    for key, value, kind in result:
        if kind:
            try:
                (value,) = tomllib.loads(f"x = [{value}]")["x"]
            except (tomllib.TOMLDecodeError, ValueError, RecursionError):
                message = f"{str(value)[:60]!r} is not a value as TOML writes it"
                raise Unreadable(f"{key}: {message}") from None
        _put(data, key, value)
    return data


def _steps(key: str) -> list[str | int]:
    steps: list[str | int] = []
    position = 0
    while position < len(key):
        match = PART.match(key, position)
        if not match or (match[3] == "." and match.end() == len(key)):
            raise Unreadable(
                f"{key!r} is not a key; write it like indexation.cap or reactions[0].name"
            )
        steps.append(next(iter(tomllib.loads(f"{match[1]} = 0"))))
        steps += [int(item) for item in re.findall(r"\d+", match[2])]
        position = match.end()
    return steps


def _put(data: dict[str, Any], key: str, value: Any) -> None:
    steps = _steps(key)
    here: Any = data
    for i, step in enumerate(steps):
        last = i == len(steps) - 1
        empty: Any = value if last else [] if isinstance(steps[i + 1], int) else {}
        if isinstance(step, int):
            if not isinstance(here, list) or step > len(here):
                raise Unreadable(f"{key}: there is no number {step} yet; entries count from 0")
            if step == len(here):
                here.append(empty)
            elif last:
                raise Unreadable(f"{key} stands there twice")
        else:
            if not isinstance(here, dict):
                raise Unreadable(f"{key}: an entry of a list has a number, [0]")
            if last and step in here:
                raise Unreadable(f"{key} stands there twice")
            here.setdefault(step, empty)
        here = here[step]  # pyright: ignore
        if not last and not isinstance(here, dict | list):
            raise Unreadable(f"{key}: a value stands there already, and not a table")
