"""Material through the whole flowsheet, unit by unit in the case's order."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..time.dynamics import Dynamics
from ..units.operation import Outcome, Timed, Unit
from .case import PharmaCase
from .feed import feed
from .grid import NO_CRYSTALS, Sizes
from .order import Group, groups, settled
from .recycle import Closed, close, labels
from .stream import Stream, blank


class Flow(NamedTuple):
    """`streams` {"unit.outlet" or feed's name: Stream}, `measures` {"unit.measure": number},
    `outcomes` {unit: Outcome}, `loops` {units of a loop, in words: how it was closed}."""

    streams: dict[str, Stream]
    measures: dict[str, Array]
    outcomes: dict[str, Outcome]
    loops: dict[str, Closed]


def sources(case: PharmaCase) -> dict[str, tuple[str, ...]]:
    """{unit: names of the streams at its inlets, in order of its inlets}."""
    fed = {(each.target, each.inlet): each.stream for each in case.connections}
    return {
        unit.name: tuple(fed[unit.name, port.name] for port in unit.inlets) for unit in case.units
    }


def leaving(case: PharmaCase) -> tuple[str, ...]:
    """Names of the streams that leave the flowsheet: into no unit, or into one without outlets."""
    into = {each.name: each for each in case.units if each.outlets}
    used = {c.stream for c in case.connections if c.target in into}
    names = [f"{unit.name}.{port}" for unit in case.units for port in unit.outlets]
    names += [each.name for each in case.feeds]
    return tuple(name for name in names if name not in used)


def crystal_sizes(case: PharmaCase) -> dict[str, Sizes]:
    """{name of a stream: the grid on which its crystals are counted}."""
    fed: dict[tuple[str, str], Sizes] = {(each.name, ""): NO_CRYSTALS for each in case.feeds}
    made, _ = settled(
        case.units, case.connections, fed, NO_CRYSTALS, lambda unit, into: unit.sizes(into)
    )
    return {f"{name}.{port}".rstrip("."): size for (name, port), size in made.items()}


def flow(
    case: PharmaCase,
    inputs: dict[str, Any],
    record: bool = False,
    ends: Mapping[str, Array] | None = None,
) -> Flow:
    """Runs every unit; with `record` tracks are kept. `ends`: {unit: its final y} of units that
    were integrated elsewhere."""
    found = _through(case, case.units, inputs, record, ends or {})
    return found._replace(measures=found.measures | yields(case, found.streams))


def problem_of(
    case: PharmaCase, unit: Timed, inputs: dict[str, Any], ends: Mapping[str, Array]
) -> Dynamics:
    """A unit's initial value problem, once the timed units before it have come to their ends."""
    before = case.units[: [each.name for each in case.units].index(unit.name)]
    streams = _through(case, before, inputs, False, ends).streams
    given = tuple(streams[name] for name in sources(case)[unit.name])
    return unit.dynamics(case.network, given, inputs)


def _through(case: PharmaCase, units: tuple[Unit, ...], inputs, record: bool, ends) -> Flow:
    streams = {each.name: feed(each, inputs) for each in case.feeds}
    measures, outcomes, loops = {}, {}, {}
    for group in groups(units, case.connections):
        found = through(case, group, streams, inputs, record, ends)
        streams, outcomes, loops = found.streams, outcomes | found.outcomes, loops | found.loops
        measures |= found.measures
    return Flow(streams, measures, outcomes, loops)


def through(
    case: PharmaCase,
    group: Group,
    streams: Mapping[str, Stream],
    inputs: dict[str, Any],
    record: bool = False,
    ends: Mapping[str, Array] | None = None,
) -> Flow:
    """The `streams` with those that a group makes; a loop's come to their steady state first."""
    loops = {}
    if group.torn:
        torn, loops[group.loop] = _torn(case, group, streams, inputs)
        streams = {**streams, **torn}
    return _along(case, group.units, streams, inputs, record, ends or {})._replace(loops=loops)


def _torn(case: PharmaCase, group: Group, streams, inputs) -> tuple[dict[str, Stream], Closed]:
    """The torn streams of a loop, which its units make again."""
    fed, inside = sources(case), {f"{u.name}.{p}" for u in group.units for p in u.outlets}
    needed = {name for unit in group.units for name in fed[unit.name]} - inside
    around = {name: streams[name] for name in sorted(needed)}, inputs
    lasting = jnp.max(jnp.stack([each.duration for each in around[0].values()]))
    guess = tuple(each.replace(duration=lasting) for each in _blanks(case, group))

    def turn(torn, around):
        streams, inputs = around
        known = {**streams, **dict(zip(group.torn, torn))}
        made = _along(case, group.units, known, inputs, False, {}).streams
        return tuple(made[name] for name in group.torn)

    found, closed = close(turn, guess, around, case.numerics)
    return dict(zip(group.torn, found)), closed


def _blanks(case: PharmaCase, group: Group) -> tuple[Stream, ...]:
    sizes = crystal_sizes(case)
    return tuple(blank(len(case.network.species), sizes[name]) for name in group.torn)


def entry_words(case: PharmaCase, loop: str) -> list[str]:
    """Words for every entry of the guess of a loop, which is called by its units."""
    group = next(g for g in groups(case.units, case.connections) if g.loop == loop)
    return labels(_blanks(case, group), group.torn, case.network.species)


def _along(case: PharmaCase, units: Sequence[Unit], streams, inputs, record: bool, ends) -> Flow:
    """Runs these units, one after the other."""
    streams, measures, outcomes, fed = dict(streams), {}, {}, sources(case)
    for unit in units:
        given = tuple(streams[name] for name in fed[unit.name])
        end = ends.get(unit.name)
        outcome = unit.operate(case.network, case.numerics, given, inputs, record, end)
        outcomes[unit.name] = outcome
        for port, stream in zip(unit.outlets, outcome.finish.outlets):
            streams[f"{unit.name}.{port}"] = stream
        for name, value in outcome.finish.measures.items():
            measures[f"{unit.name}.{name}"] = value
    return Flow(streams, measures, outcomes, {})


def yields(case: PharmaCase, streams: dict[str, Stream]) -> dict[str, Array]:
    """{"process.yield.PRODUCT.KEY": new crystals of PRODUCT per KEY fed, both in kmol;
    "process.product.PRODUCT": kg of them}, those asked for."""
    found, out = {}, leaving(case)
    species = case.network.species
    for name in asked(case):
        kind, _, names = name.removeprefix("process.").partition(".")
        if not name.startswith("process.") or kind not in ("yield", "product"):
            continue
        product, _, key = names.partition(".")
        made = species.index(product)
        crystals = jnp.zeros(())
        for each in out:
            crystals = crystals + streams[each].solid[made] - streams[each].seed[made]
        if kind == "product":
            found[name] = crystals * case.network.molar_mass[made]
        else:
            used = species.index(key)
            found[name] = crystals / sum(streams[each.name].species[used] for each in case.feeds)
    return found


def asked(case: PharmaCase) -> tuple[str, ...]:
    """The measures that attributes, and an optimisation, name."""
    terms = () if case.optimise is None else case.optimise.terms + case.optimise.per
    named = [each.measure for each in case.attributes]
    return tuple(dict.fromkeys([*named, *(each.of for each in terms if each.entry is None)]))
