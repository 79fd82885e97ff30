"""One table of a unit while it is read: its numbers, profiles and inner tables. The description of
a field is the text that an error message quotes as allowed.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, doc, parse

from .numbers import check_name, suggest

PROBABILITY = Range(0.0, 1.0, "()", noun="a probability")
TextKey = Annotated[str, Field(min_length=1)]


Texts = Annotated[list[TextKey], Field(min_length=1)]


def quantity(meaning: str, subject: str, default: Any = ...) -> Any:
    """A field for a number with a unit, required without a default."""
    return doc(meaning, default, f"a quantity in quotation marks, such as {subject}")


def whole(
    meaning: str, low: int, high: float = math.inf, default: Any = ..., note: str = ""
) -> Any:
    """A field for a whole number in a range."""
    return within(meaning, Range(low, high, note=note, noun="a whole number"), default)


def within(meaning: str, bounds: Range, default: Any = ...) -> Any:
    """A field for a number in a range; the type of the field does not repeat the range."""
    low, high = bounds.endpoints
    limits = {
        "gt" if low == "(" else "ge": bounds.low,
        "lt" if high == ")" else "le": bounds.high,
    }
    limits: Any = {name: end for name, end in limits.items() if math.isfinite(end)}
    return doc(meaning, default, str(bounds), **limits)


def tables(meaning: str, name: str) -> Any:
    """A field for an array of tables, at least one."""
    return doc(meaning, allowed=f"one table {name} or more", min_length=1)


def pair(meaning: str, subject: str) -> Any:
    """A field for a list of two."""
    return doc(meaning, allowed=f"two {subject}", min_length=2, max_length=2)


class Reader(NamedTuple):
    """A table while it is read, with its text as written; its numbers are called "name.key"."""

    section: TableContext
    name: str
    table: Any
    raw: Mapping[str, Any]

    def one_of(self, key: str, names: Sequence[str], noun: str) -> str:
        """One of these `names`."""
        name = getattr(self.table, key)
        if name not in names:
            message = f"there is no such {noun}; {suggest(name, names, noun)}"
            raise self.section.error(key, name, message)
        return name

    def ports(self, key: str) -> tuple[str, ...]:
        """Names of ports, without repetition."""
        names = getattr(self.table, key)
        for i, name in enumerate(names):
            check_name(self.section, key, name)
            if name in names[:i]:
                raise self.section.error(key, name, "this name appears twice")
        return tuple(names)

    def inner(self, key: str, table: type[CaseTable]) -> "Reader":
        """The table under `key`."""
        where = f"{self.section.name}.{key}"
        result = parse(table, getattr(self.table, key), str(self.section.file), where)
        section = TableContext(self.section.file, where, self.section.notes)
        return Reader(section, f"{self.name}.{key}", result, self.raw[key])

    def only(self, kinds: tuple[str, ...], keys: tuple[str, ...], needed: bool = False) -> None:
        """Refuses `keys` unless `kind` is one of `kinds`; for these kinds the keys may be
        `needed`."""
        kind = self.table.kind
        for key in keys:
            values = getattr(self.table, key)
            if kind not in kinds and values is not None:
                text = " or ".join(f'"{item}"' for item in kinds)
                message = f'kind "{kind}" has no such key; it belongs to {text}'
                raise self.section.error(key, self.raw[key], message)
            if kind in kinds and needed and values is None:
                raise self.section.error(key, None, f'kind "{kind}" needs this key')
