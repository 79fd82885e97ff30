"""Derivatives of every unit alone, from which paths through the flowsheet are put together."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.solver.adjoint import adjoint_jacobian

from .flow import leaving, sources, yields
from .inputs import every_given
from .mixing import feed
from .ports import outlets
from .process import Entry, Process
from .records_units import Feed, Reactor, Unit
from .stream import Stream, flat, unflat
from .units import operate


class Block(NamedTuple):
    """Derivatives of one unit alone: of its outlets and measures by its inlets and own numbers.

    K is the length of a stream as a vector, M the number of measures, E of `entries`.

    - `inlets`, `outlets`: names of the streams ("unit.outlet", or a feed's name), in order.
    - `stream`: [outlets, K, inlets, K]; `measure`: [M, inlets, K].
    - `stream_by_entry`: [outlets, K, E]; `measure_by_entry`: [M, E]; `measures`: [M] names
      without the unit's; `entries`: [E] (input, position) that the unit reads.
    """

    inlets: tuple[str, ...]
    outlets: tuple[str, ...]
    stream: np.ndarray
    measure: np.ndarray
    measures: tuple[str, ...]
    stream_by_entry: np.ndarray
    measure_by_entry: np.ndarray
    entries: tuple[Entry, ...]


class Local(NamedTuple):
    """{unit: Block}, in the order of the flow, feeds first (units without inlets).

    The block "process" has the measures "yield.PRODUCT.KEY" that the case's attributes name; its
    inlets are all streams that leave the flowsheet and all feeds.
    """

    units: dict[str, Block]


def local(process: Process, inputs=None) -> Local:
    """The derivatives of every unit alone at the streams that flow at `inputs`."""
    case, given = process.case, process.given(inputs)
    streams = process.run(inputs).streams
    fed, blocks = sources(case), {}
    for each in case.feeds:
        blocks[each.name] = _block(process, each.name, (), (each.name,), each, streams, given)
    for unit in case.units:
        out = tuple(f"{unit.name}.{port}" for port in outlets(unit))
        blocks[unit.name] = _block(process, unit.name, fed[unit.name], out, unit, streams, given)
    names = (*leaving(case), *(each.name for each in case.feeds))
    blocks["process"] = _block(process, "process", names, (), None, streams, given)
    return Local(blocks)


def _function(process: Process, unit: Feed | Unit | None, inlets) -> Callable:
    """From inlet streams and inputs to outlet streams and {measure without the unit's name}."""
    case = process.case

    def run(streams: tuple[Stream, ...], inputs):
        if unit is None:
            found = yields(case, dict(zip(inlets, streams)))
            return (), {name.removeprefix("process."): each for name, each in found.items()}
        if isinstance(unit, Feed):
            return (feed(unit, inputs),), {}
        finish = operate(unit, case.network, case.numerics, streams, inputs).finish
        return finish.outlets, finish.measures

    return run


def _entries(process: Process, unit: Feed | Unit | None) -> tuple[Entry, ...]:
    """What the unit reads: its own inputs, and for a reactor those of the network."""
    records = (unit, process.case.network) if isinstance(unit, Reactor) else (unit,)
    names = [each.name for each in every_given(records) if each.name in process.inputs]
    return tuple((name, i) for name in names for i in range(process.inputs[name].size))


def _block(process: Process, name, inlets, outlets, unit, streams, inputs) -> Block:
    entries, run = _entries(process, unit), _function(process, unit, inlets)
    fixed = tuple(streams[each] for each in inlets)
    size = len(flat(next(iter(streams.values()))))
    labels: list[str] = []

    def vectors(rows, numbers, inputs, fixed):
        given = tuple(unflat(row, like) for row, like in zip(rows, fixed))
        out, measures = run(given, process.shifted(numbers, entries, inputs))
        labels[:] = measures
        flowed = jnp.stack([flat(each) for each in out]) if out else jnp.zeros((0, size))
        measured = jnp.stack(list(measures.values())) if measures else jnp.zeros(0)
        return flowed, measured

    def derivatives(numbers, inputs, fixed):
        rows = jnp.stack([flat(each) for each in fixed]) if fixed else jnp.zeros((0, size))
        adaptive = process.case.numerics.method == "adaptive"
        derivative = adjoint_jacobian if adaptive else jax.jacfwd
        return derivative(vectors, argnums=(0, 1))(rows, numbers, inputs, fixed)

    call = process.compiled(("local", name), lambda: derivatives)
    (stream, stream_by), (measure, measure_by) = call(process.at(entries, inputs), inputs, fixed)
    return Block(inlets, outlets, stream, measure, tuple(labels), stream_by, measure_by, entries)
