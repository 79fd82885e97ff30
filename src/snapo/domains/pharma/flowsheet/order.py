"""Which units come before which, and which of them stand in a loop."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from ..units.operation import Unit
from .case import Connection

Carried = TypeVar("Carried")


class Group(NamedTuple):
    """Units that are solved together: one alone, or those of a loop, in order.

    `torn`: names of the streams that feed a unit at or before the one they come from; () without
    a loop.
    """

    units: tuple[Unit, ...]
    torn: tuple[str, ...]

    @property
    def loop(self) -> str:
        """The units in words; "" for one without a loop."""
        return " -> ".join(each.name for each in self.units) if self.torn else ""


def ancestors(units: Sequence[Unit], connections: Sequence[Connection]) -> dict[str, set[str]]:
    """{unit: every unit that material passes on its way to it, itself included}."""
    found = {unit.name: {unit.name} for unit in units}
    moved = True
    while moved:
        moved = False
        for each in (c for c in connections if c.target in found):
            new = found.get(each.source, set()) - found[each.target]
            found[each.target] |= new
            moved |= bool(new)
    return found


def in_order(units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Unit, ...]:
    """The units in the order in which material flows; those of a loop stand together."""
    before = ancestors(units, connections)
    left, found = [unit.name for unit in units], []
    while left:
        ready = [
            name
            for name in left
            if all(name in before[other] for other in before[name] if other in left)
        ]
        for name in ready:
            if name not in found:
                around = [each for each in ready if name in before[each] and each in before[name]]
                found += _around(around, connections)
        left = [name for name in left if name not in found]
    by_name = {unit.name: unit for unit in units}
    return tuple(by_name[name] for name in found)


def _around(names: list[str], connections: Sequence[Connection]) -> list[str]:
    """The units of one loop, from one that is fed from outside, so that few streams are torn."""
    outside = {c.target for c in connections if c.source not in names}
    found: list[str] = []

    def waits_for(name: str) -> int:
        into = [c.source for c in connections if c.target == name]
        return sum(source in names and source not in found for source in into)

    while len(found) < len(names):
        left = [name for name in names if name not in found]
        found.append(
            min(left, key=lambda name: (waits_for(name) > 0, name not in outside, waits_for(name)))
        )
    return found


def groups(units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Group, ...]:
    """The units, which stand in order, with those of a loop together."""
    before = ancestors(units, connections)
    place = {unit.name: i for i, unit in enumerate(units)}
    found: list[Group] = []
    for unit in units:
        if found and any(unit.name in before[each.name] for each in found[-1].units):
            found[-1] = Group((*found[-1].units, unit), ())
        else:
            found.append(Group((unit,), ()))

    def torn(group: Group) -> tuple[str, ...]:
        inside = {each.name for each in group.units}
        back = [c for c in connections if c.source in inside and c.target in inside]
        return tuple(c.stream for c in back if place[c.source] >= place[c.target])

    return tuple(Group(group.units, torn(group)) for group in found)


def settled(
    units: Sequence[Unit],
    connections: Sequence[Connection],
    fed: dict[tuple[str, str], Carried],
    start: Carried,
    of_unit: Callable[[Unit, tuple[Carried, ...]], tuple[Carried, ...]],
) -> tuple[dict[tuple[str, str], Carried], dict[str, tuple[Carried, ...]]]:
    """What every outlet carries, and what comes to the inlets of every unit.

    `of_unit` gives it for the outlets from the inlets; `fed`: of the feeds; `start`: of a stream
    of a loop at first. The units are gone through until nothing changes.
    """
    source = {(c.target, c.inlet): (c.source, c.outlet) for c in connections}
    made, into = dict(fed), {}
    for _ in range(len(units) + 1):
        last = dict(made)
        for unit in units:
            ports = [source[unit.name, inlet.name] for inlet in unit.inlets]
            into[unit.name] = tuple(made.get(port, start) for port in ports)
            out = of_unit(unit, into[unit.name])
            made |= {(unit.name, port): each for port, each in zip(unit.outlets, out)}
        if made == last:
            break
    return made, into
