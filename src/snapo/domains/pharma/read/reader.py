"""One table of a unit while it is read: its numbers, profiles and inner tables."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from snapo.case.table import CaseTable, TableContext, parse

from .names import check_name
from .numbers import suggest


class Reader(NamedTuple):
    """One table while it is read, and as it was written; its numbers are called "name.key"."""

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
        """Names of ports, each once."""
        names = getattr(self.table, key)
        for i, name in enumerate(names):
            check_name(self.section, key, name)
            if name in names[:i]:
                raise self.section.error(key, name, "this name is there twice")
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
