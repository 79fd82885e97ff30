"""Material through the whole flowsheet, unit by unit in the case's order."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .mixing import feed
from .ports import inlets, outlets
from .records import PharmaCase
from .stream import Stream
from .units import Outcome, operate


class Flow(NamedTuple):
    """`streams` {"unit.outlet" or feed's name: Stream}, `measures` {"unit.measure": number},
    `outcomes` {unit: Outcome}."""

    streams: dict[str, Stream]
    measures: dict[str, Array]
    outcomes: dict[str, Outcome]


def sources(case: PharmaCase) -> dict[str, tuple[str, ...]]:
    """{unit: names of the streams at its inlets, in order of `ports.inlets`}."""
    fed = {(each.target, each.inlet): _name(each.source, each.outlet) for each in case.connections}
    return {unit.name: tuple(fed[unit.name, port] for port in inlets(unit)) for unit in case.units}


def leaving(case: PharmaCase) -> tuple[str, ...]:
    """Names of the streams that leave the flowsheet: into no unit, or into one without outlets."""
    into = {each.name: each for each in case.units if outlets(each)}
    used = {_name(c.source, c.outlet) for c in case.connections if c.target in into}
    names = [f"{unit.name}.{port}" for unit in case.units for port in outlets(unit)]
    names += [each.name for each in case.feeds]
    return tuple(name for name in names if name not in used)


def flow(case: PharmaCase, inputs: dict[str, Any], record: bool = False) -> Flow:
    """Runs every unit; with `record` tracks are kept."""
    streams = {each.name: feed(each, inputs) for each in case.feeds}
    measures, outcomes, fed = {}, {}, sources(case)
    for unit in case.units:
        given = tuple(streams[name] for name in fed[unit.name])
        outcome = operate(unit, case.network, case.numerics, given, inputs, record)
        outcomes[unit.name] = outcome
        for port, stream in zip(outlets(unit), outcome.finish.outlets):
            streams[f"{unit.name}.{port}"] = stream
        for name, value in outcome.finish.measures.items():
            measures[f"{unit.name}.{name}"] = value
    return Flow(streams, measures | yields(case, streams), outcomes)


def yields(case: PharmaCase, streams: dict[str, Stream]) -> dict[str, Array]:
    """{"process.yield.PRODUCT.KEY": new crystals of PRODUCT per KEY fed}, those asked for."""
    found, out = {}, leaving(case)
    for name in dict.fromkeys(each.measure for each in case.attributes):
        if name.startswith("process.yield."):
            product, key = name.split(".")[2:]
            found[name] = product_yield(case, streams, out, product, key)
    return found


def product_yield(
    case: PharmaCase, streams: dict[str, Stream], out: tuple[str, ...], product: str, key: str
) -> Float[Array, ""]:
    """kmol of new crystals of `product` in the streams `out` per kmol of `key` in all feeds."""
    made, used = case.network.species.index(product), case.network.species.index(key)
    crystals = jnp.zeros(())
    for name in out:
        crystals = crystals + streams[name].solid[made] - streams[name].seed[made]
    return crystals / sum(streams[each.name].species[used] for each in case.feeds)


def _name(source: str, outlet: str) -> str:
    return f"{source}.{outlet}" if outlet else source
