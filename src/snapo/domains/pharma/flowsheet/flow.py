"""Material through the whole flowsheet, unit by unit in the case's order."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..time.dynamics import Dynamics
from ..units.operation import Outcome, Timed, Unit
from .case import PharmaCase
from .feed import feed
from .grid import NO_CRYSTALS, Sizes
from .stream import Stream


class Flow(NamedTuple):
    """`streams` {"unit.outlet" or feed's name: Stream}, `measures` {"unit.measure": number},
    `outcomes` {unit: Outcome}."""

    streams: dict[str, Stream]
    measures: dict[str, Array]
    outcomes: dict[str, Outcome]


def sources(case: PharmaCase) -> dict[str, tuple[str, ...]]:
    """{unit: names of the streams at its inlets, in order of its inlets}."""
    fed = {(each.target, each.inlet): _name(each.source, each.outlet) for each in case.connections}
    return {
        unit.name: tuple(fed[unit.name, port.name] for port in unit.inlets) for unit in case.units
    }


def leaving(case: PharmaCase) -> tuple[str, ...]:
    """Names of the streams that leave the flowsheet: into no unit, or into one without outlets."""
    into = {each.name: each for each in case.units if each.outlets}
    used = {_name(c.source, c.outlet) for c in case.connections if c.target in into}
    names = [f"{unit.name}.{port}" for unit in case.units for port in unit.outlets]
    names += [each.name for each in case.feeds]
    return tuple(name for name in names if name not in used)


def crystal_sizes(case: PharmaCase) -> dict[str, Sizes]:
    """{name of a stream: the grid on which its crystals are counted}."""
    found: dict[str, Sizes] = {each.name: NO_CRYSTALS for each in case.feeds}
    fed = sources(case)
    for unit in case.units:
        out = unit.sizes(tuple(found[name] for name in fed[unit.name]))
        found |= {f"{unit.name}.{port}": size for port, size in zip(unit.outlets, out)}
    return found


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
    measures, outcomes, fed = {}, {}, sources(case)
    for unit in units:
        given = tuple(streams[name] for name in fed[unit.name])
        end = ends.get(unit.name)
        outcome = unit.operate(case.network, case.numerics, given, inputs, record, end)
        outcomes[unit.name] = outcome
        for port, stream in zip(unit.outlets, outcome.finish.outlets):
            streams[f"{unit.name}.{port}"] = stream
        for name, value in outcome.finish.measures.items():
            measures[f"{unit.name}.{name}"] = value
    return Flow(streams, measures, outcomes)


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


def _name(source: str, outlet: str) -> str:
    return f"{source}.{outlet}" if outlet else source
