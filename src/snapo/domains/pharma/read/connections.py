"""The graph of a flowsheet: every inlet fed once, no outlet used twice, no loop, a known order."""

from collections.abc import Sequence

from snapo.case.error import CaseError
from snapo.case.table import Section, parse

from ..flowsheet.case import Connection
from ..flowsheet.feed import Feed
from ..flowsheet.grid import NO_CRYSTALS, Sizes
from ..units.operation import Inlet, Unit
from .numbers import suggest
from .tables import ConnectionTable


def read_connections(
    file, raw: list[dict], feeds: Sequence[Feed], units: Sequence[Unit]
) -> tuple[Connection, ...]:
    """`[[connections]]`, each checked against the ports that there are."""
    by_name = {unit.name: unit for unit in units}
    for feed in feeds:
        if feed.name in by_name:
            what = "a unit has this name too"
            raise CaseError(str(file), f"feeds.{feed.name}", None, what)
    sources = [feed.name for feed in feeds]
    sources += [f"{unit.name}.{port}" for unit in units for port in unit.outlets]
    targets = [f"{unit.name}.{port.name}" for unit in units for port in unit.inlets]
    found: list[Connection] = []
    used: dict[str, str] = {}
    for i, each in enumerate(raw):
        where = Section(file, f"connections[{i}]", [])
        table = parse(ConnectionTable, each, str(file), where.name)
        start, end = getattr(table, "from"), table.to  # pyright: ignore[reportAttributeAccessIssue]
        for key, port, known in (("from", start, sources), ("to", end, targets)):
            if port not in known:
                hint = suggest(port, known, "port")
                raise where.error(key, port, f"there is no such port; {hint}")
            if port in used:
                what = f"this port is connected already, to {used[port]}"
                raise where.error(key, port, what)
        used |= {start: end, end: start}
        source, _, outlet = start.partition(".")
        target, _, inlet = end.partition(".")
        found.append(Connection(source, outlet, target, inlet))
    _check_fed(file, targets, sources, used)
    return tuple(found)


def _check_fed(file, targets: list[str], sources: list[str], used: dict[str, str]) -> None:
    open_inlets = [port for port in targets if port not in used]
    if open_inlets:
        free = [port for port in sources if port not in used]
        what = f"the inlet {open_inlets[0]} is not fed"
        if free:
            what += f"; free are {', '.join(free)}"
        raise CaseError(str(file), "connections", None, what)


def in_order(file, units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Unit, ...]:
    """The units in the order in which material flows.

    **Raises:** `CaseError` that names the units of a loop.
    """
    by_name = {unit.name: unit for unit in units}
    before = {
        name: [c.source for c in connections if c.target == name and c.source in by_name]
        for name in by_name
    }
    found: list[str] = []
    while len(found) < len(by_name):
        ready = [name for name in by_name if name not in found and set(before[name]) <= set(found)]
        if not ready:
            cycle = _cycle(before, found)
            what = f"material flows in a loop, {' -> '.join(cycle)}; a flowsheet may not"
            raise CaseError(str(file), "connections", None, what)
        found += ready
    ordered = tuple(by_name[name] for name in found)
    _check_crystals(file, ordered, connections)
    return ordered


def _cycle(before: dict[str, list[str]], found: list[str]) -> list[str]:
    """A loop among the units that never become ready, in the direction of flow."""
    left = [name for name in before if name not in found]
    path = [left[0]]
    while True:
        source = next(name for name in before[path[-1]] if name in left)
        if source in path:
            loop = path[path.index(source) :]
            return [source, *reversed(loop)]
        path.append(source)


def _check_crystals(file, units: Sequence[Unit], connections: Sequence[Connection]) -> None:
    """Some units take liquids alone, and some need crystals, or need them counted by size."""
    made: dict[tuple[str, str], Sizes] = {}
    for unit in units:
        fed = {c.inlet: (c.source, c.outlet) for c in connections if c.target == unit.name}
        # What no unit made comes from a feed, which brings no crystals.
        sizes = tuple(made.get(fed[inlet.name], NO_CRYSTALS) for inlet in unit.inlets)
        for inlet, found in zip(unit.inlets, sizes):
            _check_inlet(file, unit, inlet, found)
        for port, size in zip(unit.outlets, unit.sizes(sizes)):
            made[unit.name, port] = size


def _check_inlet(file, unit: Unit, inlet: Inlet, found: Sizes) -> None:
    what = ""
    if found == NO_CRYSTALS:
        if inlet.crystals in ("needed", "counted"):
            what = "no crystals reach this unit: there is no crystalliser before it"
    elif inlet.crystals == "refused":
        what = f"crystals reach the inlet {inlet.name} of this unit, which takes liquids alone"
    elif found is None and (inlet.crystals == "counted" or inlet.grid):
        what = "crystals reach this unit whose sizes are not counted on a grid"
    elif inlet.grid and found != inlet.grid:
        what = "crystals reach this unit on another grid of sizes than its own"
    if what:
        raise CaseError(str(file), f"units.{unit.name}", None, what)
