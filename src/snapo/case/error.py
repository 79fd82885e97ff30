"""A mistake in a case, as the user reads it: file, key or line, value, and the allowed range."""

import datetime
import difflib
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any


class CaseError(ValueError):
    """A case that cannot be read, or a contract that cannot be met.

    **Arguments:**

    - `file`: the file with the mistake, under the name that the user knows.
    - `where`: the key ("contract.max_injection"), the line ("line 7") or the date.
    - `value`: the wrong value; `None` if a value is missing.
    - `allowed`: a correct value, described in a clause.
    - `others`: further mistakes in the same case.
    """

    def __init__(self, file: str, where: str, value: Any, allowed: str, others=()):
        self.file, self.where, self.value, self.allowed = file, where, value, allowed
        self.others: tuple[CaseError, ...] = tuple(others)
        super().__init__(file, where, value, allowed)

    def __str__(self) -> str:
        position = f"{self.file}, {self.where}" if self.where else self.file
        got = "" if self.value is None else f" got {show(self.value)};"
        return "\n".join([f"{position}:{got} {self.allowed}.", *map(str, self.others)])


def show(value: Any) -> str:
    """A value as the user wrote it: dates in ISO form, text in quotes, long lists cut short."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Real) and not isinstance(value, Integral):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {show(item)}" for key, item in value.items())
        value = Unquoted("{ " + inner + " }")
    if isinstance(value, list | tuple):
        value = Unquoted("[" + ", ".join(map(show, value)) + "]")
    text = value if isinstance(value, Unquoted) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class Unquoted(str):
    """A description instead of a value ("an unknown key"), shown without quotation marks."""


def nearest(key: str, available, word: str = "key") -> str:
    """Suggests the known key nearest to an unknown one, or lists them all."""
    close = difflib.get_close_matches(key, available, n=1, cutoff=0.6)
    if close:
        return f"the nearest known {word} is {close[0]}"
    return f"the known {word}s are {', '.join(available)}"


def plural(noun: str) -> str:
    """The plural of a noun of a case, "weeks" or "boxes"; symbols such as "kg" have none."""
    if not (noun.isalpha() and noun.islower() and len(noun) > 2):
        return noun
    if noun.endswith(("s", "x", "z", "ch", "sh")):
        return f"{noun}es"
    if noun.endswith("y") and noun[-2] not in "aeiou":
        return f"{noun[:-1]}ies"
    return f"{noun}s"


def counted(count: float, noun: str) -> str:
    """A number with its noun, "1 week" or "2 weeks"."""
    text = f"{int(count):,}" if count == int(count) else f"{count:,.4g}"
    return f"{text} {noun if count == 1 else plural(noun)}"
