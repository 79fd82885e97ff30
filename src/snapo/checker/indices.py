"""Indices out of range, whether they are the same on all paths or depend on the path; slices and
tables that are shorter than the horizon needs.
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jax._src import source_info_util
from jax.core import Tracer
from jax.lax import GatherScatterMode
from jaxtyping import PyTree

from snapo.lanes.jax_private import arguments_of_scan
from snapo.problem.simulator import Schedule, Simulator

from .findings import Notes
from .methods import CodeLine, line_among, line_of, methods, preparation
from .watch import CodeSite, SamplePoints

CORRECT = "Correct the index, or the size that is declared."


class Beyond(NamedTuple):
    """An index past the end: the array's name (if any), the line, the index, and the length."""

    label: str
    line: str
    index: int
    length: int


def within(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Checks that every constant index of every method is within its array; stops at errors."""
    with jax.enable_x64(True):
        for method in (preparation(simulator, inputs), *methods(simulator, schedule)):
            with notes.during(method.name):
                closed = method.traced()
            result = _beyond(closed.jaxpr, closed.consts, method.labels())
            for item in dict.fromkeys(result):
                # A negative index was written before JAX added the length to it.
                index = item.index - item.length * (item.index < 0)
                notes.error(
                    f"{notes.method(method.name)}: {item.label or 'an array'}[{index}]",
                    f"The array has {item.length} entries; JAX reads the nearest entry, or omits "
                    f"a write, without an error. In: {item.line}",
                    CORRECT,
                )
    notes.stop_on_errors()


def _beyond(jaxpr, consts, labels=(), inputs=(), caller: str = "") -> Iterator[Beyond]:
    """Walks a program with the integers that are known in it."""
    available = {v: np.asarray(c) for v, c in zip(jaxpr.constvars, consts)}
    available |= {v: x for v, x in zip(jaxpr.invars, inputs) if x is not None}
    name = dict(zip(jaxpr.invars, labels))

    def read(atom):
        return np.asarray(atom.val) if isinstance(atom, jex.Literal) else available.get(atom)

    for eqn in jaxpr.eqns:
        values = [read(atom) for atom in eqn.invars]
        line = source_info_util.summarize(eqn.source_info)
        line = caller if line == "<unknown>" else line
        label = "" if not eqn.invars else _name_of(eqn.invars[0], name)
        for index, length in _outside(eqn, values):
            yield Beyond(label, line, index, length)
        for inner, passed in _inner(eqn, values):
            names = [_name_of(a, name) for a in eqn.invars] if len(passed) == len(values) else ()
            yield from _beyond(inner.jaxpr, inner.consts, names, passed, line)
        if eqn.primitive.name in _ARITHMETIC and all(x is not None for x in values):
            result = _ARITHMETIC[eqn.primitive.name](eqn, *values)
            if result is not None and result.size <= MAXIMUM and result.dtype.kind in "iub":
                available[eqn.outvars[0]] = result
        elif eqn.primitive.name == "convert_element_type" and not isinstance(
            eqn.invars[0], jex.Literal
        ):
            name[eqn.outvars[0]] = _name_of(eqn.invars[0], name)


MAXIMUM = 100_000  # entries of an index array that is followed


def _name_of(atom, names: dict) -> str:
    return "" if isinstance(atom, jex.Literal) else names.get(atom, "")


def _outside(eqn, values) -> Iterator[tuple[int, int]]:
    """(index, length) of every known index of an equation that lies outside."""
    kind = eqn.primitive.name
    shape = [int(n) for n in getattr(eqn.invars[0].aval, "shape", ())] if eqn.invars else []
    if kind == "dynamic_slice":
        for start, length, size in zip(values[1:], shape, eqn.params["slice_sizes"]):
            if start is not None and not 0 <= int(start) <= length - size:
                yield int(start), length
    elif kind == "gather" and values[1] is not None:
        if eqn.params["mode"] != GatherScatterMode.PROMISE_IN_BOUNDS:
            return
        axes, sizes = eqn.params["dimension_numbers"].start_index_map, eqn.params["slice_sizes"]
        yield from _worst(values[1], [(shape[a], sizes[a]) for a in axes])
    elif kind.startswith("scatter") and values[1] is not None:
        axes = eqn.params["dimension_numbers"].scatter_dims_to_operand_dims
        yield from _worst(values[1], [(shape[a], 1) for a in axes])


def _worst(indices: np.ndarray, ranges: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """One entry outside of each range, of indices [..., ranges]."""
    for k, (length, size) in enumerate(ranges):
        column = indices[..., k]
        outside = column[(column < 0) | (column > length - size)]
        if outside.size:
            yield int(outside.flat[0]), length


def _inner(eqn, values):
    """The programs inside an equation, with the known values of their arguments."""
    kind, params = eqn.primitive.name, eqn.params
    if kind == "cond":
        return [(branch, values[1:]) for branch in params["branches"]]
    if kind == "scan":
        fixed, _ = arguments_of_scan(params)
        return [(params["jaxpr"], values[:fixed])]
    results = [x for x in params.values() if isinstance(x, jex.ClosedJaxpr)]
    return [(x, values if len(x.jaxpr.invars) == len(values) else []) for x in results]


def _iota(eqn):
    params = eqn.params
    shape, axis = params["shape"], params["dimension"]
    line = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(line, shape).astype(params["dtype"])


def _broadcast(eqn, x, *_):
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    wide = [1] * len(shape)
    for size, axis in zip(x.shape, axes):
        wide[axis] = size
    return np.broadcast_to(x.reshape(wide), shape)


def _integers(eqn, x):
    kind = np.dtype(eqn.params["new_dtype"]).kind
    return x.astype(eqn.params["new_dtype"]) if kind in "iub" and x.dtype.kind in "iub" else None


# The primitives of which indices are made, on known arrays.
_ARITHMETIC: dict[str, Any] = {
    "lt": lambda eqn, a, b: a < b,
    "ge": lambda eqn, a, b: a >= b,
    "add": lambda eqn, a, b: a + b,
    "sub": lambda eqn, a, b: a - b,
    "mul": lambda eqn, a, b: a * b,
    "select_n": lambda eqn, which, *cases: np.choose(which.astype(int), cases),
    "squeeze": lambda eqn, x: x.reshape(eqn.outvars[0].aval.shape),
    "reshape": lambda eqn, x, *_: x.reshape(eqn.outvars[0].aval.shape),
    "concatenate": lambda eqn, *xs: np.concatenate(xs, eqn.params["dimension"]),
    "iota": _iota,
    "broadcast_in_dim": _broadcast,
    "convert_element_type": _integers,
}


MEANT = "Write jnp.clip(index, 0, length - 1) if the nearest entry is meant."
FEW = 32  # points outside at which the entry that is read is looked at


def moving_indices(notes: Notes, points: SamplePoints) -> None:
    """Reads outside an array that affect a result, and writes outside it, which JAX drops."""
    recorder, reported = points.recorder, set()
    if not recorder.reads:
        return
    sites = zip(recorder.reads, points.met.outside)
    for number, (site, (index, axis, is_outside)) in enumerate(sites):
        which = np.flatnonzero(is_outside)
        if not which.size or (site.line is not None and site.line.internal):
            continue
        if not site.writes and not _matters(points, number, which):
            continue
        position, length, size = _met(site, index[which], axis[which])
        if (site.line, length) not in reported:
            reported.add((site.line, length))
            _write(notes, points.method.name, site, _said(position, length, size))


def _matters(points: SamplePoints, number: int, which: np.ndarray) -> bool:
    """Whether the entry that is read outside moves a result: `jnp.where` may leave it out."""
    which = which[np.unique(np.linspace(0, len(which) - 1, min(len(which), FEW)).astype(int))]
    arguments = points.some(which)
    here = points.recorder.nothing(len(which))._replace(read=np.int32(number))
    as_read, up, down = (
        points.observe(arguments, here._replace(shift=np.float64(shift))).results
        for shift in (0, 1, -1)
    )
    return any(
        not np.array_equal(x, y, equal_nan=x.dtype.kind == "f")
        for other in (up, down)
        for x, y in zip(as_read, other)
    )


def _met(site: CodeSite, index: np.ndarray, axis: np.ndarray) -> tuple[int, int, int]:
    """The index farthest outside as written, the length of the axis, and the size of the part."""
    ranges = np.array(site.ranges)[axis]
    k = int(np.argmax(np.where(index < 0, -index, index - ranges[:, 0] + ranges[:, 1])))
    length, size = (int(n) for n in ranges[k])
    # A negative one was written before JAX added the length to it.
    return int(index[k]) - length * int(index[k] < 0), length, size


def _said(index: int, length: int, size: int) -> str:
    if size > 1:
        return f"{size} entries are taken from index {index} on, but the array has {length}"
    return f"an index is {index}, but the array has {length} entries"


def _write(notes: Notes, method: str, site: CodeSite, message: str) -> None:
    where = f"{method}, {site.line}" if site.line else notes.method(method)
    text = f" In: {site.line.text}" if site.line else ""
    where_met = "With these inputs," if method == "prepare" else "On a path,"
    done = "drops such a write" if site.writes else "reads the nearest one"
    note = notes.warning if site.writes else notes.error
    note(
        where,
        f"{where_met} {message}: JAX {done}, without an error.{text}",
        CORRECT if site.writes else f"{CORRECT} {MEANT}",
    )


class Short(NamedTuple):
    """A slice, the length of the axis that it is taken from, and its line."""

    requested: str
    length: int
    line: CodeLine


def short_slices(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Checks that every slice of every method is within its array."""
    with jax.enable_x64(True):
        for method in (preparation(simulator, inputs), *methods(simulator, schedule)):
            with notes.during(method.name), _asked() as result:
                method.traced()
            for item in dict.fromkeys(result):
                notes.warning(
                    f"{method.name}, {item.line}",
                    f"The slice [{item.requested}] is taken from an array of {item.length} "
                    "entries: the result is shorter than the bounds say, without an error. In: "
                    f"{item.line.text}",
                    "Correct the slice, or the size that is declared.",
                )


@contextmanager
def _asked() -> Iterator[list[Short]]:
    """The slices past an end that this thread's code takes of traced arrays."""
    past_end: list[Short] = []
    mine, before = threading.get_ident(), Tracer.__getitem__

    def getitem(self, index):
        if threading.get_ident() == mine and (line := _users_line(sys._getframe(1))):
            past_end.extend(Short(*item, line) for item in _past(index, self.shape))
        return before(self, index)

    Tracer.__getitem__ = getitem
    try:
        yield past_end
    finally:
        Tracer.__getitem__ = before


def _users_line(frame: Any) -> CodeLine | None:
    """The line of a user's code that takes a slice itself; none in libraries and in snapo."""
    line = line_among([(frame.f_code.co_filename, frame.f_lineno)])
    return None if line is None or line.internal else line


def _past(index: Any, shape: tuple[int, ...]) -> Iterator[tuple[str, int]]:
    """(slice, length) of the parts of an index that reach past the end of their axis."""
    parts = index if isinstance(index, tuple) else (index,)
    if any(np.dtype(getattr(part, "dtype", int)).kind == "b" for part in parts):
        return  # a mask takes as many axes as it has
    taken = sum(part is not None and part is not Ellipsis for part in parts)
    axis = 0
    for part in parts:
        if part is Ellipsis:
            axis += len(shape) - taken
        elif part is not None:
            if isinstance(part, slice) and axis < len(shape) and outside(part, shape[axis]):
                yield _written(part), shape[axis]
            axis += 1


def outside(part: slice, length: int) -> bool:
    """Whether an end of a slice is outside of an axis."""
    endpoints = [end for end in (part.start, part.stop) if isinstance(end, int | np.integer)]
    backwards = isinstance(part.step, int) and part.step < 0
    # Backwards, [n::-1] starts at an entry, and [:-n - 1:-1] ends at an entry.
    low = -length - 1 if backwards else -length
    return any(not low <= end <= length for end in endpoints)


def _written(part: slice) -> str:
    start, stop = ("" if end is None else end for end in (part.start, part.stop))
    return f"{start}:{stop}" if part.step is None else f"{start}:{stop}:{part.step}"


TABLE = (
    "A NumPy table that is used inside a method keeps the precision in which JAX used it first: "
    "put it into the schedule, Schedule({'table': table}, …), or write "
    "jnp.asarray(table.tolist()) where it is used."
)


class TraceTable(NamedTuple):
    """An array of a program that has another precision, and the line that first uses it."""

    shape: tuple[int, ...]
    dtype: str
    line: CodeLine | None


def tables(notes: Notes, simulator: Simulator, schedule: Schedule) -> None:
    """Checks every method as training traces it, then as evaluation does; stops at errors."""
    # JAX keeps a table's conversion as long as a program holds it, as compiled ones do.
    selected: list[Any] = []
    for precision in ("float32", "float64", "float32"):
        dtype = np.dtype(precision)
        with jax.enable_x64(precision == "float64"):
            for method in methods(simulator, schedule, dtype=dtype):
                try:
                    closed = method.traced()
                except Exception as error:
                    where, message, _ = notes.explained(error, method.name)
                    notes.error(where, f"It fails in {precision}. {message}", TABLE)
                    continue
                selected.append(closed)
                for result in dict.fromkeys(_others(closed, dtype)):
                    _write_table(notes, method.name, result, precision)
        notes.stop_on_errors()


def _write_table(notes: Notes, method: str, result: TraceTable, precision: str) -> None:
    where = f"{method}, {result.line}" if result.line else notes.method(method)
    text = f" In: {result.line.text}" if result.line else ""
    notes.error(
        where,
        f"A table of shape {result.shape} is {result.dtype}, but the others are {precision}.{text}",
        TABLE,
    )


def _others(closed: Any, dtype: np.dtype, caller: CodeLine | None = None) -> Iterator[TraceTable]:
    """The floating tables of a program, and of those inside it, of another type than `dtype`."""
    for var in closed.jaxpr.constvars:
        kind = np.dtype(var.aval.dtype)
        if jnp.issubdtype(kind, jnp.floating) and kind != dtype:
            users = (eqn for eqn in closed.jaxpr.eqns if any(x is var for x in eqn.invars))
            user = next(users, None)
            line = line_of(user) if user is not None else None
            yield TraceTable(tuple(var.aval.shape), kind.name, line or caller)
    for eqn in closed.jaxpr.eqns:
        for inner in jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_program):
            if _is_program(inner):
                yield from _others(inner, dtype, line_of(eqn) or caller)


def _is_program(x: Any) -> bool:
    return isinstance(x, jex.ClosedJaxpr)
