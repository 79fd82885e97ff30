"""Mistakes that traces of the methods show: randomness, loops without an end, lost derivatives."""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.code.lost import lost
from snapo.problem.code.version import read_context, text
from snapo.problem.problem import in_mean
from snapo.problem.simulator import Schedule, Simulator, at
from snapo.problem.smooth import Exact, Smooth

from .findings import Notes
from .methods import CodeLine, Method, line_of, methods, preparation

SHAPE = jax.ShapeDtypeStruct


def repeatable(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """Two traces of every method must be the same program."""
    noise: Any = np.full(simulator.noise_size, 0.1)
    action: Any = np.full(simulator.action.size, 0.5)
    initial_noise: Any = np.full(simulator.initial_noise_size, 0.1)

    with jax.enable_x64(True):
        # Arrays of JAX, as the engines give them: one of NumPy takes no index that is traced.
        constants, now = jax.tree.map(jnp.asarray, (schedule.constants, at(schedule.steps, 0)))
        start = jax.eval_shape(lambda: simulator.initial(constants, initial_noise))
        calls = {
            "prepare": lambda: (
                lambda v: simulator.prepare(inputs_.replace(inputs, v)),
                inputs_.values(inputs),
            ),
            "initial": lambda: (lambda z: simulator.initial(constants, z), initial_noise),
            "observe": lambda: (lambda s: simulator.observe(constants, now, s), start),
            "step": lambda: (
                lambda x: [
                    simulator.step(constants, now, x[0], x[1], x[2], smooth)
                    for smooth in (Exact(), Smooth(0.1))
                ],
                (start, action, noise),
            ),
            "terminal": lambda: (lambda s: simulator.terminal(constants, s, Exact()), start),
        }
        for name, fresh in calls.items():
            with notes.during(name):
                if _anew(text, *fresh()) == _anew(text, *fresh()):
                    continue
                # Programs may differ only in their text; numbers decide.
                both = [_filled(*fresh()) for _ in range(2)]
                first, second = (jax.tree.leaves(_anew(jax.jit(item), z)) for item, z in both)
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second)):
                notes.error(
                    notes.method(name),
                    "Two calls with the same arguments differ: randomness, a clock or a counter "
                    "in Python.",
                    "Use the noise argument of step, and carry changing numbers in the state.",
                )
    notes.stop_on_errors()


def _anew(function: Callable, *values: Any) -> Any:
    """A call for which JAX traces everything again, including functions traced before."""
    with read_context(object()):
        return function(*values)


def _filled(function: Callable, argument: PyTree) -> tuple[Callable, PyTree]:
    """A function and its argument, with ones for leaves that have only a shape."""

    def filled(leaf: Any) -> Any:
        return np.ones(leaf.shape, leaf.dtype) if isinstance(leaf, SHAPE) else leaf

    return function, jax.tree.map(filled, argument, is_leaf=lambda leaf: isinstance(leaf, SHAPE))


def loops(notes: Notes, simulator: Simulator, inputs: PyTree, schedule: Schedule) -> None:
    """`jax.lax.while_loop`, and `fori_loop` between numbers that JAX traces, as errors.

    A loop without derivatives, such as one over whole numbers, is allowed.
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
                    "No derivative can be computed through a loop whose number of iterations is "
                    "not fixed (jax.lax.while_loop)." + (f" In: {line.text}" if line else ""),
                    "Write jax.lax.fori_loop or jax.lax.scan with a fixed number of iterations, "
                    "and jnp.where to keep results that are complete.",
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
    """Whether reverse mode can differentiate a method; nothing is computed."""
    values = list(method.arguments.values())
    noise = [name == "noise" for name in method.arguments]  # its derivative is never needed

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


def lost_derivatives(notes: Notes, simulator: Simulator, inputs: PyTree) -> None:
    """Inputs that affect the outputs only through rounding or comparisons, as warnings."""
    right = in_mean(simulator, inputs)
    for name, equations in lost(simulator, inputs).items():
        if name in right:
            continue
        lines = dict.fromkeys(line for eqn in equations if (line := line_of(eqn)))
        positions = ", ".join(map(str, lines))
        texts = " In: " + "; ".join(line.text for line in lines) if lines else ""
        notes.warning(
            f"input {name}" + (f" ({positions})" if positions else ""),
            "Its derivative is lost: the input affects the outputs only through rounding, whole "
            "numbers or comparisons. The derivative is then 0 on every path, and the true "
            f"derivative is not known.{texts}",
            "Draw whole numbers with snapo.noise (Poisson, Binomial, Empirical), whose derivative "
            "is correct in the mean, use smooth.indicator and smooth.round, or do not round.",
        )
