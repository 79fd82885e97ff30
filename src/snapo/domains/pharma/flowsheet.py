"""The graph of a flowsheet: every inlet fed once, no outlet used twice, no loop, a known order."""

from collections.abc import Sequence

from snapo.case.error import CaseError
from snapo.case.table import Section, parse

from .ports import inlets, outlets
from .read_numbers import suggest
from .records import Connection
from .records_units import Crystalliser, Dissolution, Dryer, Feed, Filter, TrayDryer, Unit
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
    sources += [f"{unit.name}.{port}" for unit in units for port in outlets(unit)]
    targets = [f"{unit.name}.{port}" for unit in units for port in inlets(unit)]
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
    _check_crystals(file, ordered, before)
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


def _check_crystals(file, units: Sequence[Unit], before: dict[str, list[str]]) -> None:
    """Filters, dryers and dissolution need crystals, which only a crystalliser makes."""
    crystals: set[str] = set()
    for unit in units:
        on_grid = isinstance(unit, Crystalliser) and unit.edges is not None
        if on_grid and crystals & set(before[unit.name]):
            what = "crystals reach this unit, and a grid of sizes starts from its own seed alone"
            raise CaseError(str(file), f"units.{unit.name}.method", "finite-volumes", what)
        if isinstance(unit, Crystalliser) or crystals & set(before[unit.name]):
            crystals.add(unit.name)
        if isinstance(unit, Filter | Dryer | TrayDryer | Dissolution) and unit.name not in crystals:
            what = "no crystals reach this unit: there is no crystalliser before it"
            raise CaseError(str(file), f"units.{unit.name}", None, what)


def ancestors(units: Sequence[Unit], connections: Sequence[Connection]) -> dict[str, set[str]]:
    """{unit: every unit that material passes on its way to it, itself included}."""
    found: dict[str, set[str]] = {}
    for unit in units:
        sources = {c.source for c in connections if c.target == unit.name}
        found[unit.name] = {unit.name}.union(*(found.get(name, set()) for name in sources))
    return found
