"""The graph of a flowsheet: every inlet fed once, no outlet used twice, a known order."""

from collections.abc import Sequence

from snapo.case.error import CaseError
from snapo.case.table import TableContext, parse

from ..flowsheet.case import Connection
from ..flowsheet.feed import Feed
from ..flowsheet.grid import NO_CRYSTALS, Sizes
from ..flowsheet.order import groups, in_order, settled
from ..units.operation import Inlet, Instant, Unit
from .numbers import suggest
from .tables import ConnectionTable


def read_connections(
    file, raw: list[dict], feeds: Sequence[Feed], units: Sequence[Unit]
) -> tuple[Connection, ...]:
    """`[[connections]]`, each checked against the ports that there are."""
    by_name = {unit.name: unit for unit in units}
    for feed in feeds:
        if feed.name in by_name:
            message = "a unit has the same name"
            raise CaseError(str(file), f"feeds.{feed.name}", None, message)
    sources = [feed.name for feed in feeds]
    sources += [f"{unit.name}.{port}" for unit in units for port in unit.outlets]
    targets = [f"{unit.name}.{port.name}" for unit in units for port in unit.inlets]
    connections: list[Connection] = []
    used: dict[tuple[str, str], str] = {}  # an inlet and an outlet of a unit may share a name
    for i, item in enumerate(raw):
        where = TableContext(file, f"connections[{i}]", [])
        table = parse(ConnectionTable, item, str(file), where.name)
        start, end = getattr(table, "from"), table.to  # pyright: ignore[reportAttributeAccessIssue]
        for key, port, available in (("from", start, sources), ("to", end, targets)):
            if port not in available:
                hint = suggest(port, available, "port")
                raise where.error(key, port, f"there is no such port; {hint}")
            if (key, port) in used:
                message = f"this port is connected already, to {used[key, port]}"
                raise where.error(key, port, message)
        used |= {("from", start): end, ("to", end): start}
        source, _, outlet = start.partition(".")
        target, _, inlet = end.partition(".")
        connections.append(Connection(source, outlet, target, inlet))
    _check_fed(file, targets, sources, used)
    return tuple(connections)


def _check_fed(
    file, targets: list[str], sources: list[str], used: dict[tuple[str, str], str]
) -> None:
    open_inlets = [port for port in targets if ("to", port) not in used]
    if open_inlets:
        free = [port for port in sources if ("from", port) not in used]
        message = f"the inlet {open_inlets[0]} is not fed"
        if free:
            message += f"; free are {', '.join(free)}"
        raise CaseError(str(file), "connections", None, message)


def ordered(file, units: Sequence[Unit], connections: Sequence[Connection]) -> tuple[Unit, ...]:
    """The units in the order in which material flows, those of a loop one after the other.

    **Raises:** `CaseError` that names the units of a loop which cannot be at a steady state, or a
    unit that is fed with crystals it does not take.
    """
    order = in_order(units, connections)
    for group in groups(order, connections):
        for unit in group.units if group.torn else ():
            if not isinstance(unit, Instant):
                message = (
                    f"{unit.name} runs over time and is in a loop, {group.loop}; a loop is "
                    "solved at its steady state, of units that are at theirs all the time"
                )
                raise CaseError(str(file), "connections", None, message)
    _check_crystals(file, order, connections)
    return order


def _check_crystals(file, units: Sequence[Unit], connections: Sequence[Connection]) -> None:
    """Some units take only liquids, and some need crystals, or need them counted by size."""
    fed: dict[tuple[str, str], Sizes] = {(c.source, ""): NO_CRYSTALS for c in connections}
    _, into = settled(units, connections, fed, NO_CRYSTALS, lambda unit, sizes: unit.sizes(sizes))
    for unit in units:
        for inlet, result in zip(unit.inlets, into[unit.name]):
            _check_inlet(file, unit, inlet, result)


def _check_inlet(file, unit: Unit, inlet: Inlet, result: Sizes) -> None:
    message = ""
    if result == NO_CRYSTALS:
        if inlet.crystals in ("needed", "counted"):
            message = "no crystals reach this unit: there is no crystalliser before it"
    elif inlet.crystals == "refused":
        message = f"crystals reach the inlet {inlet.name} of this unit, which takes only liquids"
    elif result is None and (inlet.crystals == "counted" or inlet.grid):
        message = "crystals reach this unit whose sizes are not counted on a grid"
    elif inlet.grid and result != inlet.grid:
        message = "crystals reach this unit on a different grid of sizes"
    if message:
        raise CaseError(str(file), f"units.{unit.name}", None, message)
