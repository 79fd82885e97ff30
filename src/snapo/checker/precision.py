"""Both precisions: training is float32, values are float64, and one simulator serves both."""

from collections.abc import Iterator

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from snapo.engine import Xla
from snapo.engine.base import cast
from snapo.problem.noise import Stored
from snapo.problem.simulator import Simulator, at
from snapo.problem.smooth import Exact

from .findings import Notes
from .rollout import Run

TABLE = (
    "A NumPy table that is used inside a method keeps the precision in which JAX met it first: "
    "put it into the schedule, Schedule({'table': table}, …), or write "
    "jnp.asarray(table.tolist()) where it is used."
)


def both_precisions(notes: Notes, simulator: Simulator, run: Run) -> None:
    """Rolls two of the paths in float32, then in float64, as training and evaluation do."""
    draws = Stored(run.draws.initial_noise[:2], run.draws.step_noise[:, :2])  # pyright: ignore
    weights = {name: np.full(2, 0.5) for name in run.totals}
    given = (simulator, run.policy, run.schedule, draws, run.smooth, weights)
    for precision in ("float32", "float64"):
        engine = Xla(precision=precision)
        try:
            jax.block_until_ready(engine.adjoint(*given).totals)
            with engine.numbers():
                others = sorted(set(tables(simulator, _given(run, engine.dtype), engine.dtype)))
        except Exception as error:
            where, what, _ = notes.explained(error, "step")
            notes.error(where, f"It fails in {precision} after the other precision. {what}", TABLE)
            return
        for shape, dtype in others:
            notes.error(
                notes.method("step"),
                f"A table of shape {shape} is {dtype} where all else is {precision}.",
                TABLE,
            )
        if others:
            return


def _given(run: Run, dtype) -> tuple:
    """All that a step is given, of the first path and step."""
    schedule, states, actions, noise = cast(
        (run.schedule, run.states, run.actions, run.draws.step_noise), dtype
    )
    state = jax.tree.map(lambda leaf: leaf[0, 0], states)
    return schedule.constants, at(schedule.steps, 0), state, actions[0, 0], noise[0, 0]


def tables(simulator: Simulator, given: tuple, dtype) -> Iterator[tuple[tuple[int, ...], str]]:
    """Shape and type of the arrays in a step's program that have another precision.

    `given` are its constants, numbers of a step, state, action and noise.
    """

    def step(constants, now, state, action, drawn):
        return simulator.step(constants, now, state, action, drawn, Exact())

    closed = jax.make_jaxpr(step)(*given)
    programs = [closed]
    while programs:
        program = programs.pop()
        for var in program.jaxpr.constvars:
            kind = np.dtype(var.aval.dtype)
            if jnp.issubdtype(kind, jnp.floating) and kind != dtype:
                yield var.aval.shape, kind.name
        for eqn in program.jaxpr.eqns:
            programs += [x for x in eqn.params.values() if isinstance(x, jex.ClosedJaxpr)]
