"""Reads species, reactions, feeds and connections. A reaction must conserve mass; every inlet must
be fed once, and no outlet used twice. Units are put in the order of the flow.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import TableContext, parse

from ..flowsheet.case import Connection
from ..flowsheet.feed import Feed
from ..flowsheet.network import FlowNetwork
from ..flowsheet.order import groups, in_order, settled
from ..flowsheet.stream import NO_CRYSTALS, Sizes
from ..units.operation import Inlet, Instant, Unit
from .declared import values
from .numbers import (
    ANY,
    NOT_NEGATIVE,
    POSITIVE,
    absent,
    case_input,
    check_name,
    position,
    quantity,
    suggest,
)
from .quantities import prefactor_unit
from .reader import Reader
from .tables import ConnectionTable, ReactionTable, SpeciesTable

TERM = re.compile(r"(?:(\d+\.?\d*|\.\d+)\s*)?([A-Za-z][A-Za-z0-9_-]*)")
MASS_TOLERANCE = 1e-4  # textbooks give molar masses to a few digits: 211.22 for 211.213
ROUND_OFF = 1e-12


def read_network(
    file, species: dict, reactions: list[dict], reference: Any, notes: list[str]
) -> FlowNetwork:
    """The reactions of the case; without any, nothing reacts."""
    section = TableContext(file, "species", notes)
    names = tuple(check_name(section, name, name) for name in species)
    if not names:
        raise CaseError(str(file), "species", None, "a case needs one species or more")
    masses = []
    for name, raw in species.items():
        table = parse(SpeciesTable, raw, str(file), f"species.{name}")
        inner = TableContext(file, f"species.{name}", notes)
        masses.append(quantity(inner, "molar_mass", table.molar_mass, "kg/kmol", POSITIVE))
    molar_mass = np.array(masses)
    read = [_reaction(file, raw, i, names, molar_mass, notes) for i, raw in enumerate(reactions)]
    labels = tuple(item["name"] for item in read)
    for i, label in enumerate(labels):
        if label in labels[:i]:
            where = f"reactions[{i}].name"
            raise CaseError(str(file), where, label, "another reaction has this name")
    count, size = len(read), len(names)
    temperature = None
    if reference is not None:
        top = TableContext(file, "case", notes)
        temperature = quantity(top, "reference_temperature", reference, "K", POSITIVE)
    units = {entry["unit"] for entry in read}
    unit = units.pop() if len(units) == 1 else "(m3/kmol)^(order-1)/s"

    def of_all(key: str, measured: str, bounds: Range = ANY) -> CaseInput:
        if not count:
            return absent(f"kinetics.{key}", measured)
        values = np.array([value[key] for value in read])
        text = ReactionTable.model_fields[key].title or ""
        where = tuple(
            position(item["section"], key, item["unit"] if key == "prefactor" else measured)
            for item in read
        )
        return case_input(
            f"kinetics.{key}",
            values,
            labels,
            measured,
            meaning=text,
            bounds=bounds,
            positions=where,
        )

    return FlowNetwork(
        species=names,
        molar_mass=molar_mass,
        reactions=labels,
        stoichiometry=np.array([each["row"] for each in read]).reshape(count, size),
        order=np.array([each["order"] for each in read]).reshape(count, size),
        prefactor=of_all("prefactor", unit, NOT_NEGATIVE),
        activation=of_all("activation", "J/mol"),
        heat=of_all("heat", "J/mol"),
        reference=temperature,
    )


def _reaction(file, raw, i: int, species, molar_mass, notes) -> dict[str, Any]:
    where = f"reactions[{i}]"
    table = parse(ReactionTable, raw, str(file), where)
    section = TableContext(file, where, notes)
    name = check_name(section, "name", table.name)
    left, right = _sides(section, table.equation, species)
    used, made = left @ molar_mass, right @ molar_mass
    gap = abs(made - used) / used
    if gap > MASS_TOLERANCE:
        message = (
            f"mass is not conserved: the left side weighs {used:.10g} g/mol and the right side "
            f"{made:.10g} g/mol"
        )
        raise section.error("equation", table.equation, message)
    if gap > ROUND_OFF:
        notes.append(
            f"With the molar masses of the case, reaction {name} conserves mass only to {gap:.1e}; "
            "the mass balance shows the difference as produced by the reaction."
        )
    order = left.copy()
    for item, exponent in table.order.items():
        at = _species(section, f"order.{item}", item, species)
        order[at] = quantity(section, f"order.{item}", exponent, "1", NOT_NEGATIVE)
    total = order.sum()
    unit = prefactor_unit(total)
    return {
        "name": name,
        "section": section,
        "row": right - left,
        "order": order,
        "unit": unit,
        "prefactor": quantity(section, "prefactor", table.prefactor, unit, NOT_NEGATIVE),
        "activation": quantity(section, "activation", table.activation, "J/mol"),
        "heat": quantity(section, "heat", table.heat, "J/mol"),
    }


def _sides(section: TableContext, equation: str, species) -> tuple[np.ndarray, np.ndarray]:
    """What one mole of reaction uses and makes, [S] each."""
    sides = equation.split("->")
    if len(sides) != 2:
        raise section.error("equation", equation, 'it must be an equation such as "A + 2 B -> C"')
    results = []
    for side in sides:
        amounts = np.zeros(len(species))
        for term in side.split("+"):
            match = TERM.fullmatch(term.strip())
            if match is None:
                message = 'it must be an equation such as "A + 2 B -> C"'
                raise section.error("equation", equation, message)
            at = _species(section, "equation", match[2], species, equation)
            amounts[at] += float(match[1] or 1)
        results.append(amounts)
    if not (results[0] @ results[0] and results[1] @ results[1]):
        raise section.error("equation", equation, "both sides need a species")
    return results[0], results[1]


def _species(section: TableContext, key: str, name: str, species, displayed=None) -> int:
    if name not in species:
        message = f"there is no species {name}; {suggest(name, species, 'species')}"
        raise section.error(key, name if displayed is None else displayed, message)
    return species.index(name)


def read_feeds(file, feeds: dict, species: tuple[str, ...], notes: list[str]) -> tuple[Feed, ...]:
    """`[feeds.NAME]`, in the order of the file."""
    results = []
    for name, raw in feeds.items():
        where = f"feeds.{name}"
        section = TableContext(file, where, notes)
        check_name(TableContext(file, "feeds", notes), name, name)
        table: Any = parse(Feed.table, raw, str(file), where, notes)
        amounts = np.zeros(len(species))
        for item, raw_amount in table.concentration.items():
            at = _species(section, f"concentration.{item}", item, species)
            key = f"concentration.{item}"
            amounts[at] = quantity(section, key, raw_amount, "kmol/m3", NOT_NEGATIVE)
        read = Reader(section, name, table, raw)
        text = "concentration in the feed"
        results.append(
            Feed(
                name=name,
                concentration=case_input(
                    f"{name}.concentration",
                    amounts,
                    species,
                    "kmol/m3",
                    meaning=text,
                    bounds=NOT_NEGATIVE,
                    positions=tuple(
                        position(section, f"concentration.{item}", "kmol/m3") for item in species
                    ),
                ),
                **values(Feed, read),
            )
        )
    return tuple(results)


def read_connections(
    file, raw: list[dict], feeds: Sequence[Feed], units: Sequence[Unit]
) -> tuple[Connection, ...]:
    """`[[connections]]`, checked against the existing ports."""
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
            message += f"; unused outlets are {', '.join(free)}"
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
                    f"{unit.name} runs over time and is in a loop, {group.loop}; all units of a "
                    "loop must be at steady state all the time"
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
        message = "the crystals that reach this unit are not counted on a grid of sizes"
    elif inlet.grid and result != inlet.grid:
        message = "the crystals that reach this unit are counted on a different grid of sizes"
    if message:
        raise CaseError(str(file), f"units.{unit.name}", None, message)
