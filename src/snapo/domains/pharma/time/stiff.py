"""A stiff unit on held steps, which error control chooses once and which are the same in every run.

With the steps held as shares of the duration, the final state is a fixed composition of smooth maps
of the inputs, and its derivatives, in any mode and order, are exactly those of the computed
numbers. The error estimate of every step is computed again in every run, which shows whether the
steps are too long for this run.
"""

from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, Int, jax, jnp

from .dynamics import Dynamics
from .mesh import break_up, edges_of
from .profile import values_in
from .rosenbrock import Push, push, rosenbrock

FLOOR = 1e-6  # of scaled states, below which an error counts absolutely
LOOSER, ENOUGH = 1e3, 1e-6  # refused: errors above this multiple of the tolerance and this number


class Steps(NamedTuple):
    """`start` and `end` of n steps, shares of the duration; `number`: the number of the piece
    between nodes of the profiles in which every step lies."""

    start: Float[np.ndarray | Array, " n"]
    end: Float[np.ndarray | Array, " n"]
    number: Int[np.ndarray | Array, " n"]


def steps_of(problem: Dynamics, times: Float[np.ndarray, " n+1"]) -> Steps:
    """Steps between `times`, shares of the duration, and divided where a profile has a node."""
    edges = edges_of(tuple(profile for profile, _ in problem.controls))
    times = np.union1d(times, edges)
    number = np.searchsorted(edges, times[:-1], side="right") - 1
    return Steps(times[:-1], times[1:], number.astype(np.int32))


def pushed(problem: Dynamics, number, start, end) -> Push:
    """The drive over one step, from share `start` to `end` within piece `number`."""
    segments = break_up(edges_of(tuple(profile for profile, _ in problem.controls)), None)
    local = [segments.of(profile)[number] for profile, _ in problem.controls]
    endpoints = [
        [values_in(*control, piece, share) for control, piece in zip(problem.controls, local)]
        for share in (start, end)
    ]
    return push(problem.drive, *endpoints)


def size_of_error(error: Array, y: Array, after: Array) -> Float[Array, ""]:
    """The largest error estimate relative to its state, or to `FLOOR` if the state is smaller."""
    size = jnp.max(jnp.abs(error) / (FLOOR + jnp.maximum(jnp.abs(y), jnp.abs(after))))
    return jax.lax.stop_gradient(size)


def limit_of(tolerance: float) -> float:
    """The error of a step at which a run is refused."""
    return max(LOOSER * tolerance, ENOUGH)


class Stepped(NamedTuple):
    """`final`: y [m] at the end, NaN if a step was refused; `states`: [n + 1, m] or None; `share`:
    the share of the duration at which the refused step begins, else 1; `error`: the largest error
    of a step."""

    final: Float[Array, " m"]
    states: Float[Array, "n+1 m"] | None
    share: Float[Array, ""]
    error: Float[Array, ""]


def stepped(problem: Dynamics, steps: Steps, limit: float, record: bool) -> Stepped:
    """The problem on held steps; a step with an error above `limit` is refused."""
    start, end, number = (jnp.asarray(item) for item in steps)
    pushes = jax.vmap(lambda *now: pushed(problem, *now))(number, start, end)

    def advance(y, now):
        after, error, _ = rosenbrock(problem.rate, y, *now)
        return after, (size_of_error(error, y, after), after if record else None)

    step = problem.duration * (end - start)
    final, (sizes, later) = jax.lax.scan(advance, problem.start, (step, pushes))
    valid = sizes <= limit  # not where it is not a number
    every = jnp.all(valid)
    share = jnp.where(every, 1.0, start[jnp.argmin(valid)])
    states = None if later is None else jnp.concatenate([problem.start[None], later])
    return Stepped(jnp.where(every, final, jnp.nan), states, share, jnp.max(sizes))


def schedule(problem: Dynamics, steps: Steps) -> tuple[Array, Array]:
    """Shares of the duration [n + 1], and the controls [n + 1, C] there; at a jump, the earlier
    values."""
    segments = break_up(edges_of(tuple(profile for profile, _ in problem.controls)), None)
    times = jnp.append(jnp.asarray(steps.start), jnp.asarray(steps.end)[-1])
    number = jnp.append(jnp.asarray(steps.number)[:1], jnp.asarray(steps.number))
    values = [
        values_in(*control, segments.of(control[0])[number], times) for control in problem.controls
    ]
    return times, jnp.stack(values, -1)
