"""Loops of which only a run tells the number of rounds: nothing passes through them backwards."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.extend.core as jex
from jaxtyping import PyTree

from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth

from .findings import Notes
from .program.methods import CodeLine, Method, line_of, methods, preparation


def loops(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """`jax.lax.while_loop`, and `fori_loop` between numbers that JAX traces, as errors.

    One that no derivative meets, such as a loop over whole numbers, may stay.
    """
    with jax.enable_x64(True):
        made = preparation(simulator, inputs)
        for method in (made, *methods(simulator, schedule, Smooth(0.1))):
            with notes.during(method.name):
                lines = dict.fromkeys(_while_loops(method.traced().jaxpr, None))
            if lines and not _differentiable(method):
                line = next((item for item in lines if item), None)
                notes.error(
                    f"{method.name}, {line}" if line else notes.method(method.name),
                    "Nothing can be differentiated through a loop whose number of rounds is not "
                    "fixed (jax.lax.while_loop)." + (f" In: {line.text}" if line else ""),
                    "Write jax.lax.fori_loop or jax.lax.scan with a fixed number of rounds, and "
                    "jnp.where to keep what is done.",
                )
    notes.stop_on_errors()


def _while_loops(jaxpr: Any, caller: CodeLine | None) -> Iterator[CodeLine | None]:
    """The lines of all loops of this kind in a program."""
    for eqn in jaxpr.eqns:
        line = line_of(eqn) or caller
        if eqn.primitive.name == "while":
            yield line
        for inner in jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_program):
            if _is_program(inner):
                yield from _while_loops(getattr(inner, "jaxpr", inner), line)


def _is_program(x: Any) -> bool:
    return isinstance(x, jex.Jaxpr | jex.ClosedJaxpr)


def _differentiable(method: Method) -> bool:
    """Whether a method can be differentiated backwards; nothing is computed."""
    values = list(method.arguments.values())
    noise = [name == "noise" for name in method.arguments]  # nobody asks for its derivative

    def back(*arguments: Any) -> Any:
        held = [x if fixed else None for x, fixed in zip(arguments, noise)]
        free = [None if fixed else x for x, fixed in zip(arguments, noise)]
        moving, rest = eqx.partition(free, eqx.is_inexact_array)

        def results(moving: Any) -> Any:
            complete = eqx.combine(moving, rest)
            called = [h if fixed else x for x, h, fixed in zip(complete, held, noise)]
            return eqx.filter(method.function(*called), eqx.is_inexact_array)

        made, pull = jax.vjp(results, moving)
        return pull(made)

    try:
        jax.eval_shape(back, *values)
    except ValueError as error:
        return "while_loop" not in str(error)
    return True
