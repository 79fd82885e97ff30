"""The flow of material through the whole flowsheet, unit by unit in the case's order."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..time.dynamics import Dynamics
from ..units.operation import Outcome, Timed, Unit
from .case import Flowsheet
from .feed import feed
from .order import Group, groups, settled
from .recycle import Closed, close, labels
from .stream import NO_CRYSTALS, Sizes, Stream, blank


class Flow(NamedTuple):
    """`streams` {"unit.outlet" or feed's name: Stream}, `measures` {"unit.measure": number},
    `outcomes` {unit: Outcome}, `loops` {units of a loop, as text: how it was closed}."""

    streams: dict[str, Stream]
    measures: dict[str, Array]
    outcomes: dict[str, Outcome]
    loops: dict[str, Closed]


def sources(sheet: Flowsheet) -> dict[str, tuple[str, ...]]:
    """{unit: names of the streams at its inlets, in order of its inlets}."""
    fed = {
        (connection.target, connection.inlet): connection.stream for connection in sheet.connections
    }
    return {
        unit.name: tuple(fed[unit.name, port.name] for port in unit.inlets) for unit in sheet.units
    }


def leaving(sheet: Flowsheet) -> tuple[str, ...]:
    """Names of the streams that leave the flowsheet: those that feed no unit, or a unit without
    outlets."""
    into = {item.name: item for item in sheet.units if item.outlets}
    used = {c.stream for c in sheet.connections if c.target in into}
    names = [f"{unit.name}.{port}" for unit in sheet.units for port in unit.outlets]
    names += [entry.name for entry in sheet.feeds]
    return tuple(name for name in names if name not in used)


def crystal_sizes(sheet: Flowsheet) -> dict[str, Sizes]:
    """{name of a stream: the grid on which its crystals are counted}."""
    fed: dict[tuple[str, str], Sizes] = {(item.name, ""): NO_CRYSTALS for item in sheet.feeds}
    made, _ = settled(
        sheet.units,
        sheet.connections,
        fed,
        NO_CRYSTALS,
        lambda unit, into: unit.sizes(into),
    )
    return {f"{name}.{port}".rstrip("."): size for (name, port), size in made.items()}


def flow(
    sheet: Flowsheet,
    inputs: dict[str, Any],
    record: bool = False,
    endpoints: Mapping[str, Array] | None = None,
) -> Flow:
    """Runs every unit; `record`: keep the trajectories. `endpoints`: {unit: its final y} for units
    that were integrated elsewhere."""
    result = _through(sheet, sheet.units, inputs, record, endpoints or {})
    return result._replace(measures=result.measures | yields(sheet, result.streams))


def problem_of(
    sheet: Flowsheet, unit: Timed, inputs: dict[str, Any], endpoints: Mapping[str, Array]
) -> Dynamics:
    """A unit's initial value problem, after the timed units before it were integrated to their
    ends."""
    before = sheet.units[: [item.name for item in sheet.units].index(unit.name)]
    streams = _through(sheet, before, inputs, False, endpoints).streams
    values = tuple(streams[name] for name in sources(sheet)[unit.name])
    return unit.dynamics(sheet.network, values, inputs)


def _through(sheet: Flowsheet, units: tuple[Unit, ...], inputs, record: bool, endpoints) -> Flow:
    streams = {item.name: feed(item, inputs) for item in sheet.feeds}
    measures, outcomes, loops = {}, {}, {}
    for group in groups(units, sheet.connections):
        result = through(sheet, group, streams, inputs, record, endpoints)
        streams, outcomes, loops = result.streams, outcomes | result.outcomes, loops | result.loops
        measures |= result.measures
    return Flow(streams, measures, outcomes, loops)


def through(
    sheet: Flowsheet,
    group: Group,
    streams: Mapping[str, Stream],
    inputs: dict[str, Any],
    record: bool = False,
    endpoints: Mapping[str, Array] | None = None,
) -> Flow:
    """The `streams` with those of the outlets of a group; a loop is solved for its steady state."""
    loops = {}
    if group.torn:
        torn, loops[group.loop] = _torn(sheet, group, streams, inputs)
        streams = {**streams, **torn}
    return _along(sheet, group.units, streams, inputs, record, endpoints or {})._replace(
        loops=loops
    )


def _torn(sheet: Flowsheet, group: Group, streams, inputs) -> tuple[dict[str, Stream], Closed]:
    """The tear streams of a loop, which its units compute again."""
    fed, inside = sources(sheet), {f"{u.name}.{p}" for u in group.units for p in u.outlets}
    needed = {name for unit in group.units for name in fed[unit.name]} - inside
    around = {name: streams[name] for name in sorted(needed)}, inputs
    lasting = jnp.max(jnp.stack([item.duration for item in around[0].values()]))
    guess = tuple(entry.replace(duration=lasting) for entry in _blanks(sheet, group))

    def turn(torn, around):
        streams, inputs = around
        available = {**streams, **dict(zip(group.torn, torn))}
        made = _along(sheet, group.units, available, inputs, False, {}).streams
        return tuple(made[name] for name in group.torn)

    result, closed = close(turn, guess, around, sheet.numerics)
    return dict(zip(group.torn, result)), closed


def _blanks(sheet: Flowsheet, group: Group) -> tuple[Stream, ...]:
    sizes = crystal_sizes(sheet)
    return tuple(blank(len(sheet.network.species), sizes[name]) for name in group.torn)


def entry_words(sheet: Flowsheet, loop: str) -> list[str]:
    """A description of every entry of the guess of a loop, with the loop's units as its name."""
    group = next(g for g in groups(sheet.units, sheet.connections) if g.loop == loop)
    return labels(_blanks(sheet, group), group.torn, sheet.network.species)


def _along(
    sheet: Flowsheet, units: Sequence[Unit], streams, inputs, record: bool, endpoints
) -> Flow:
    """Runs these units, one after the other."""
    streams, measures, outcomes, fed = dict(streams), {}, {}, sources(sheet)
    for unit in units:
        values = tuple(streams[name] for name in fed[unit.name])
        end = endpoints.get(unit.name)
        outcome = unit.operate(sheet.network, sheet.numerics, values, inputs, record, end)
        outcomes[unit.name] = outcome
        for port, stream in zip(unit.outlets, outcome.finish.outlets):
            streams[f"{unit.name}.{port}"] = stream
        for name, value in outcome.finish.measures.items():
            measures[f"{unit.name}.{name}"] = value
    return Flow(streams, measures, outcomes, {})


def yields(sheet: Flowsheet, streams: dict[str, Stream]) -> dict[str, Array]:
    """The requested ones of {"process.yield.PRODUCT.KEY": new crystals of PRODUCT per KEY fed, both
    in kmol; "process.product.PRODUCT": kg of these crystals}."""
    table, out = {}, leaving(sheet)
    species = sheet.network.species
    for name in sheet.measures:
        kind, _, names = name.removeprefix("process.").partition(".")
        if not name.startswith("process.") or kind not in ("yield", "product"):
            continue
        product, _, key = names.partition(".")
        made = species.index(product)
        crystals = jnp.zeros(())
        for item in out:
            crystals = crystals + streams[item].solid[made] - streams[item].seed[made]
        if kind == "product":
            table[name] = crystals * sheet.network.molar_mass[made]
        else:
            used = species.index(key)
            table[name] = crystals / sum(streams[entry.name].species[used] for entry in sheet.feeds)
    return table
