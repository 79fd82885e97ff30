"""NumPy tables inside a method, which JAX keeps in the precision in which it met them first.

Training is float32 and the value float64. A table that is met in one of them and used in the
other loses digits, or both clash, in the engine that compiles it.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from snapo.problem.simulator import Schedule, Simulator

from ..findings import Notes
from ..program.methods import CodeLine, line_of, methods

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
                    _write(notes, method.name, result, precision)
        notes.stop_on_errors()


def _write(notes: Notes, method: str, result: TraceTable, precision: str) -> None:
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
