"""One step at a time, for the native engine: the step as a function, and the schedule of all."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .dynamics import Dynamics
from .mesh import break_up, edges_of, local_points, steps_per_piece
from .numerics import Numerics
from .rosenbrock import push, rosenbrock
from .runge_kutta import runge_kutta
from .stiff import limit_of, size_of_error, steps_of

MarchSchedule = dict[str, np.ndarray]  # of each of T steps


def mesh_march(
    problem: Dynamics, numerics: Numerics, held: Float[np.ndarray, " n+1"] | None
) -> tuple[Callable, MarchSchedule]:
    """A step, (y, the schedule's row) -> y, and the schedule: the steps of `integrate` on a mesh,
    or those `held` of a stiff unit."""
    if held is not None:
        return _stiff(problem, numerics, held)
    return _explicit(problem, numerics)


def _explicit(problem: Dynamics, numerics: Numerics) -> tuple[Callable, MarchSchedule]:
    """`piece`: [T] number of the piece; `local`: [T, 3, 3] start, middle and end of the step within
    the piece, for each grading."""
    segments = break_up(edges_of(tuple(profile for profile, _ in problem.controls)), problem.event)
    endpoints = [segments.endpoints(*control) for control in problem.controls]
    seconds = problem.duration * jnp.diff(segments.breaks)

    def advance(y, now):
        k = now["piece"]
        local = segments.grading[k] @ now["local"]
        controls = (first[k] + (last[k] - first[k]) * local for first, last in endpoints)
        return runge_kutta(
            problem.rate, y, seconds[k] * (local[2] - local[0]), problem.drive(*controls)
        )

    count = len(segments.source)
    n = steps_per_piece(numerics.steps, count)
    points = local_points(n)
    start, end = points[:, :-1], points[:, 1:]
    local = np.moveaxis(np.stack([start, (start + end) / 2, end], -1), 1, 0)
    number = np.repeat(np.arange(count, dtype=np.int32), n)
    return advance, {"piece": number, "local": np.tile(local, (count, 1, 1))}


def _stiff(
    problem: Dynamics, numerics: Numerics, held: Float[np.ndarray, " n+1"]
) -> tuple[Callable, MarchSchedule]:
    """`piece`: [T]; `endpoints`: [T, 2] start and end of the step within the piece; `width`: [T] of
    the step, a share of the duration. y is not a number after a step that is refused."""
    edges = edges_of(tuple(profile for profile, _ in problem.controls))
    segments, steps = break_up(edges, None), steps_of(problem, held)
    endpoints = [segments.endpoints(*control) for control in problem.controls]
    limit = limit_of(numerics.stiff_tolerance)

    def advance(y, now):
        k = now["piece"]
        start, end = (
            [first[k] + (last[k] - first[k]) * now["ends"][i] for first, last in endpoints]
            for i in range(2)
        )
        drive = push(problem.drive, start, end)
        after, error, _ = rosenbrock(
            problem.rate, y, problem.duration * now["width"], drive, scanned=False
        )
        return jnp.where(size_of_error(error, y, after) <= limit, after, jnp.nan)

    first, last, number = (np.asarray(step) for step in steps)
    left, width = edges[number], np.diff(edges)[number]
    local = np.stack([(item - left) / width for item in (first, last)], 1)
    return advance, {"piece": number, "ends": local, "width": last - first}
