"""One table of a unit while it is read: its numbers, profiles and inner tables."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, parse

from ..time.profile import Profile
from .names import check_name
from .numbers import ANY, POSITIVE, profile, quantity, single, suggest


class Reader(NamedTuple):
    """One table while it is read, and as it stands; its numbers are called "name.key"."""

    section: TableContext
    name: str
    table: Any
    raw: Mapping[str, Any]

    def meaning(self, key: str) -> str:
        """The meaning of a key, as its table says it."""
        return type(self.table).model_fields[key].title or key.replace("_", " ")

    def number(self, key: str, unit: str, bounds: Range = ANY) -> CaseInput:
        raw, name = getattr(self.table, key), f"{self.name}.{key}"
        return single(self.section, name, key, raw, unit, bounds, self.meaning(key))

    def optional(self, key: str, unit: str, bounds: Range = ANY) -> CaseInput | None:
        return None if getattr(self.table, key) is None else self.number(key, unit, bounds)

    def plain(self, key: str, unit: str, bounds: Range = ANY) -> float:
        return quantity(self.section, key, getattr(self.table, key), unit, bounds)

    def profile(self, key: str, unit: str, bounds: Range = POSITIVE) -> Profile:
        raw, name = getattr(self.table, key), f"{self.name}.{key}"
        return profile(self.section, name, key, raw, unit, bounds, self.meaning(key))

    def one_of(self, key: str, names: Sequence[str], noun: str) -> str:
        """One of these `names`."""
        name = getattr(self.table, key)
        if name not in names:
            message = f"there is no such {noun}; {suggest(name, names, noun)}"
            raise self.section.error(key, name, message)
        return name

    def ports(self, key: str) -> tuple[str, ...]:
        """Names of ports, each once."""
        names = getattr(self.table, key)
        for i, name in enumerate(names):
            check_name(self.section, key, name)
            if name in names[:i]:
                raise self.section.error(key, name, "this name stands there twice")
        return tuple(names)

    def inner(self, key: str, table: type[CaseTable]) -> "Reader":
        """The table under `key`."""
        where = f"{self.section.name}.{key}"
        result = parse(table, getattr(self.table, key), str(self.section.file), where)
        section = TableContext(self.section.file, where, self.section.notes)
        return Reader(section, f"{self.name}.{key}", result, self.raw[key])

    def only(self, kinds: tuple[str, ...], keys: tuple[str, ...], needed: bool = False) -> None:
        """Refuses `keys` where `kind` is not one of `kinds`; where it is they may be `needed`."""
        kind = self.table.kind
        for key in keys:
            values = getattr(self.table, key)
            if kind not in kinds and values is not None:
                text = " or ".join(f'"{item}"' for item in kinds)
                message = f'kind "{kind}" has no such key; it belongs to {text}'
                raise self.section.error(key, self.raw[key], message)
            if kind in kinds and needed and values is None:
                raise self.section.error(key, None, f'kind "{kind}" needs this key')
