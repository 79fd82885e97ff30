"""Which units come before which."""

from collections.abc import Sequence

from ..units.operation import Unit
from .case import Connection


def ancestors(units: Sequence[Unit], connections: Sequence[Connection]) -> dict[str, set[str]]:
    """{unit: every unit that material passes on its way to it, itself included}."""
    found: dict[str, set[str]] = {}
    for unit in units:
        sources = {c.source for c in connections if c.target == unit.name}
        found[unit.name] = {unit.name}.union(*(found.get(name, set()) for name in sources))
    return found
