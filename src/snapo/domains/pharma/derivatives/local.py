"""Separate derivatives of every unit, from which paths through the flowsheet are composed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from snapo.case.quantity import numbers_in

from ..flowsheet.feed import Feed, feed
from ..flowsheet.flow import leaving, sources, through, yields
from ..flowsheet.order import Group, groups
from ..flowsheet.process import PharmaProcess
from ..flowsheet.stream import Stream, flat, unflat
from ..given import Entry
from .mode import of_method

# From inlet streams and inputs to outlet streams and {measure with the unit's name}.
LocalRun = Callable[[tuple[Stream, ...], dict[str, Any]], tuple[tuple[Stream, ...], dict[str, Any]]]


class DerivativeBlock(NamedTuple):
    """Derivatives of a single unit: of outlets and measures with respect to inlets and numbers.

    K is the length of the longest stream as a vector, M the number of measures, E of `entries`.

    A loop counts as one unit, whose name is the text of its units.

    - `inlets`, `outlets`: names of the streams ("unit.outlet", or a feed's name), in order.
    - `stream`: [outlets, K, inlets, K]; `measure`: [M, inlets, K].
    - `stream_by_entry`: [outlets, K, E]; `measure_by_entry`: [M, E]; `measures`: [M] names
      with the unit's; `entries`: [E] (input, position) that the unit reads.
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

    The block "process" has the measures "process.yield.PRODUCT.KEY" that the case's attributes
    name; its inlets are all streams that leave the flowsheet and all feeds.
    """

    units: dict[str, DerivativeBlock]


def local(process: PharmaProcess, inputs=None) -> Local:
    """The derivatives of every single unit at the streams for `inputs`."""
    case, values = process.case, process.nominal_inputs(inputs)
    streams = process.run(inputs).streams
    fed, blocks = sources(case.flowsheet), {}

    def block(
        name: str, into: tuple[str, ...], out: tuple[str, ...], entries, run: LocalRun
    ) -> None:
        blocks[name] = _block(process, name, into, out, entries, run, streams, values)

    for item in case.feeds:
        block(item.name, (), (item.name,), _entries(process, item, False), _of_feed(item))
    for group in groups(case.units, case.connections):
        made = [f"{unit.name}.{port}" for unit in group.units for port in unit.outlets]
        fed_with = dict.fromkeys(name for unit in group.units for name in fed[unit.name])
        into = tuple(name for name in fed_with if name not in made)
        out = tuple(name for name in made if name not in fed_with)
        reacts = any(unit.reacts for unit in group.units)
        entries = _entries(process, group.units, reacts)
        name = group.loop or group.units[0].name
        block(name, into, out, entries, _of_group(process, group, into, out))
    names = (*leaving(case.flowsheet), *(entry.name for entry in case.feeds))
    block("process", names, (), (), _of_process(process, names))
    return Local(blocks)


def _of_feed(record: Feed) -> LocalRun:
    return lambda streams, inputs: ((feed(record, inputs),), {})


def _of_group(
    process: PharmaProcess, group: Group, into: tuple[str, ...], out: tuple[str, ...]
) -> LocalRun:
    def run(streams, inputs):
        result = through(process.case.flowsheet, group, dict(zip(into, streams)), inputs)
        return tuple(result.streams[name] for name in out), result.measures

    return run


def _of_process(process: PharmaProcess, names: tuple[str, ...]) -> LocalRun:
    def run(streams, inputs):
        return (), yields(process.case.flowsheet, dict(zip(names, streams)))

    return run


def _entries(process: PharmaProcess, record: Any, reacts: bool) -> tuple[Entry, ...]:
    """The unit's inputs and, if it `reacts`, those of the network of reactions."""
    records = (record, process.case.network) if reacts else (record,)
    names = [number.name for number in numbers_in(records) if number.name in process.inputs]
    return tuple((name, i) for name in names for i in range(process.inputs[name].size))


def _block(
    process: PharmaProcess, name, inlets, outlets, entries, run: LocalRun, streams, inputs
) -> DerivativeBlock:
    fixed = tuple(streams[inlet] for inlet in inlets)
    size = max(len(flat(item)) for item in streams.values())
    labels: list[str] = []

    def filled(stream: Stream):
        """The vector padded to the length of the longest one: streams differ in the crystals that
        they count."""
        vector = flat(stream)
        return jnp.pad(vector, (0, size - len(vector)))

    def vectors(rows, numbers, inputs, fixed):
        values = tuple(unflat(row[: len(flat(like))], like) for row, like in zip(rows, fixed))
        out, measures = run(values, process.shifted(numbers, entries, inputs))
        labels[:] = measures
        flowed = jnp.stack([filled(entry) for entry in out]) if out else jnp.zeros((0, size))
        measured = jnp.stack(list(measures.values())) if measures else jnp.zeros(0)
        return flowed, measured

    def derivatives(numbers, inputs, fixed):
        rows = jnp.stack([filled(value) for value in fixed]) if fixed else jnp.zeros((0, size))
        derivative = of_method(process.case.numerics.method)
        return derivative(vectors, argnums=(0, 1))(rows, numbers, inputs, fixed)

    call = process.compiled(("local", name), lambda: derivatives)
    (stream, stream_by), (measure, measure_by) = call(process.at(entries, inputs), inputs, fixed)
    return DerivativeBlock(
        inlets, outlets, stream, measure, tuple(labels), stream_by, measure_by, entries
    )
