"""The order of the units in the flow, and the loops of the flowsheet."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from ..units.operation import Unit
from .case import Connection

Carried = TypeVar("Carried")


class Group(NamedTuple):
    """Units that are solved together: a single unit, or the units of a loop, in order.

    `torn`: names of the streams that feed the unit from which they come, or an earlier one; ()
    without a loop.
    """

    units: tuple[Unit, ...]
    torn: tuple[str, ...]

    @property
    def loop(self) -> str:
        """The units as text; "" for one without a loop."""
        return " -> ".join(unit.name for unit in self.units) if self.torn else ""


def ancestors(units: Sequence[Unit], connections: Sequence[Connection]) -> dict[str, set[str]]:
    """{unit: every unit that material passes before it leaves this unit, including the unit
    itself}."""
    table = {unit.name: {unit.name} for unit in units}
    moved = True
    while moved:
        moved = False
        for connection in (c for c in connections if c.target in table):
            new = table.get(connection.source, set()) - table[connection.target]
            table[connection.target] |= new
            moved |= bool(new)
    return table


def in_order(units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Unit, ...]:
    """The units in the order in which material flows; those of a loop are together."""
    before = ancestors(units, connections)
    left, results = [unit.name for unit in units], []
    while left:
        ready = [
            name
            for name in left
            if all(name in before[other] for other in before[name] if other in left)
        ]
        for name in ready:
            if name not in results:
                around = [item for item in ready if name in before[item] and item in before[name]]
                results += _around(around, connections)
        left = [name for name in left if name not in results]
    by_name = {unit.name: unit for unit in units}
    return tuple(by_name[name] for name in results)


def _around(names: list[str], connections: Sequence[Connection]) -> list[str]:
    """The units of one loop in order, from a unit that is fed from outside, so that few streams are
    torn."""
    outside = {c.target for c in connections if c.source not in names}
    around: list[str] = []

    def waits_for(name: str) -> int:
        into = [c.source for c in connections if c.target == name]
        return sum(source in names and source not in around for source in into)

    while len(around) < len(names):
        left = [name for name in names if name not in around]
        around.append(
            min(left, key=lambda name: (waits_for(name) > 0, name not in outside, waits_for(name)))
        )
    return around


def groups(units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Group, ...]:
    """Groups of units in their order: the units of a loop are one group."""
    before = ancestors(units, connections)
    position = {unit.name: i for i, unit in enumerate(units)}
    results: list[Group] = []
    for unit in units:
        if results and any(unit.name in before[item.name] for item in results[-1].units):
            results[-1] = Group((*results[-1].units, unit), ())
        else:
            results.append(Group((unit,), ()))

    def torn(group: Group) -> tuple[str, ...]:
        inside = {entry.name for entry in group.units}
        back = [c for c in connections if c.source in inside and c.target in inside]
        return tuple(c.stream for c in back if position[c.source] >= position[c.target])

    return tuple(Group(group.units, torn(group)) for group in results)


def settled(
    units: Sequence[Unit],
    connections: Sequence[Connection],
    fed: dict[tuple[str, str], Carried],
    start: Carried,
    of_unit: Callable[[Unit, tuple[Carried, ...]], tuple[Carried, ...]],
) -> tuple[dict[tuple[str, str], Carried], dict[str, tuple[Carried, ...]]]:
    """Results for every outlet, and for the inlets of every unit.

    `of_unit` computes the values of the outlets from those of the inlets; `fed`: the values of the
    feeds; `start`: initial value in a loop. Units are evaluated repeatedly until the result no
    longer changes.
    """
    source = {(c.target, c.inlet): (c.source, c.outlet) for c in connections}
    made, into = dict(fed), {}
    for _ in range(len(units) + 1):
        last = dict(made)
        for unit in units:
            ports = [source[unit.name, inlet.name] for inlet in unit.inlets]
            into[unit.name] = tuple(made.get(port, start) for port in ports)
            out = of_unit(unit, into[unit.name])
            made |= {(unit.name, port): item for port, item in zip(unit.outlets, out)}
        if made == last:
            break
    return made, into
