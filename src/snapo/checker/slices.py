"""Slices and tables that are shorter than the horizon needs."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from snapo.problem.simulator import Schedule, Simulator

from .findings import Notes
from .methods import CodeLine, line_among, line_of, methods, preparation


class Short(NamedTuple):
    """A slice, the length of the axis that it is taken of, and its line."""

    requested: str
    length: int
    line: CodeLine


def short_slices(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Every slice of every method is within its array."""
    with jax.enable_x64(True):
        for method in (preparation(simulator, inputs), *methods(simulator, schedule)):
            with notes.during(method.name), _asked() as result:
                method.traced()
            for item in dict.fromkeys(result):
                notes.warning(
                    f"{method.name}, {item.line}",
                    f"The slice [{item.requested}] is taken of {item.length} entries: it is "
                    f"shorter than its bounds, without an error. In: {item.line.text}",
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
    "A NumPy table that is used inside a method keeps the precision in which JAX met it first: "
    "put it into the schedule, Schedule({'table': table}, …), or write "
    "jnp.asarray(table.tolist()) where it is used."
)


class TraceTable(NamedTuple):
    """An array of a program that has another precision, and the line that first uses it."""

    shape: tuple[int, ...]
    dtype: str
    line: CodeLine | None


def tables(notes: Notes, simulator: Simulator, schedule: Schedule) -> None:
    """Every method as training traces it, and then as evaluation does; stops at errors."""
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
        f"A table of shape {result.shape} is {result.dtype} where all else is {precision}.{text}",
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
