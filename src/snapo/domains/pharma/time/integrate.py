"""Time integration: classical Runge-Kutta steps on a mesh of pieces, held Rosenbrock steps, or
error-controlled steps by diffrax.

The residual of the differential equation between fixed steps shows whether they were short enough.
For every step the cubic Hermite interpolant is inserted into the equation at the midpoint (Enright,
SIAM J. Numer. Anal. 1989). If a step is too long for the fastest motion, the residual is as large
as the state itself, even if the ends look smooth; elsewhere it falls with the fourth power of the
step.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from snapo.problem.record import TreeRecord
from snapo.problem.record.arrays import Array, Float, eqx, jax, jnp

from .dynamics import Dynamics, Numerics, Track
from .mesh import Mesh, edges_of, make_mesh
from .profile import values_at
from .runge_kutta import final_state, runge_kutta
from .step_choice import own_steps
from .stiff import Stepped, Steps, limit_of, schedule, stepped, steps_of

MEMORY = 2**20  # numbers in one matrix for every step, above which derivatives go step by step
OWN, MORE = 2, 100  # steps tried for a stiff run: twice the nominal ones plus these


class Solved(NamedTuple):
    """The `final` y, the control values at the end, the time `reached` in s (the duration if all
    went well), and the trajectory, if requested; `error`: the largest error estimate of a step,
    relative to its state, or None."""

    final: Float[Array, " m"]
    controls: list[Array]
    reached: Float[Array, ""]
    track: Track | None
    error: Float[Array, ""] | None = None


def integrate(
    problem: Dynamics,
    numerics: Numerics,
    record: bool = False,
    held: Float[np.ndarray, " n+1"] | None = None,
) -> Solved:
    """Solves the unit's initial value problem; with `record`, its track on the mesh. On a mesh,
    `held` are the times of a stiff unit's steps (`Numerics.held`)."""
    if held is not None and numerics.method == "mesh":
        return _held(problem, numerics, held, record)
    edges = edges_of(tuple(profile for profile, _ in problem.controls))
    mesh = make_mesh(edges, numerics.steps, problem.event)
    solve = _on_mesh if numerics.method == "mesh" else _adaptive
    states, final, share = solve(problem, numerics, mesh, record)
    endpoints = [value[-1] for _, value in problem.controls]
    reached = problem.duration * share
    if states is None:
        return Solved(final, endpoints, reached, None)
    controls = jnp.stack([mesh.point_values(*control) for control in problem.controls], -1)
    slope = jax.vmap(problem.rate)(states, problem.drive(*controls.T))
    time = problem.duration * mesh.times()
    return Solved(final, endpoints, reached, Track(time, states, slope, controls))


def _held(problem: Dynamics, numerics: Numerics, held: np.ndarray, record: bool) -> Solved:
    """The solution on the held steps of a stiff unit; if these are refused and `numerics.own_steps`
    is set, on steps chosen for this run."""
    nominal, limit = steps_of(problem, held), limit_of(numerics.stiff_tolerance)
    endpoints = [value[-1] for _, value in problem.controls]
    maximum = OWN * len(nominal.end) + MORE if numerics.own_steps else len(nominal.end)

    def on(steps: Steps) -> tuple[Stepped, Track | None]:
        results = stepped(problem, steps, limit, record)
        if results.states is None:
            return results, None
        times, controls = schedule(problem, steps)
        slope = jax.vmap(problem.rate)(results.states, problem.drive(*controls.T))
        track = Track(problem.duration * times, results.states, slope, controls)
        filled = maximum + 1 - len(times)  # with the end, again and again
        return results._replace(states=None), jax.tree.map(
            lambda item: jnp.concatenate([item, jnp.repeat(item[-1:], filled, 0)]), track
        )

    result, track = on(nominal)
    if numerics.own_steps:
        result, track = jax.lax.cond(
            result.share < 1.0,
            lambda: on(own_steps(problem, numerics.stiff_tolerance, maximum)),
            lambda: (result._replace(states=None), track),
        )
    return Solved(result.final, endpoints, problem.duration * result.share, track, result.error)


def ended(problem: Dynamics, final: Float[Array, " m"]) -> Solved:
    """The result of `integrate` if the final y is already available."""
    return Solved(final, [value[-1] for _, value in problem.controls], problem.duration, None)


def _on_mesh(problem: Dynamics, numerics: Numerics, mesh: Mesh, record: bool):
    """States [n + 1, m] or None, the last of them, and the share of the time that is finite."""
    drive = problem.drive(*(mesh.values(*control) for control in problem.controls))
    step = problem.duration * (mesh.stages[:, 2] - mesh.stages[:, 0])

    def advance(y, now):
        after = runge_kutta(problem.rate, y, *now)
        return after, after if record else None

    if not (record or numerics.along) and len(step) * problem.start.size**2 <= MEMORY:
        final, later = final_state(problem.rate, problem.start, step, drive), None
    else:
        final, later = jax.lax.scan(advance, problem.start, (step, drive))
    share = jnp.where(jnp.all(jnp.isfinite(final)), 1.0, 0.0)
    if later is None:
        return None, final, share
    finite = jnp.all(jnp.isfinite(later), axis=1)
    share = jnp.where(jnp.all(finite), 1.0, mesh.stages[jnp.argmin(finite), 0])
    return jnp.concatenate([problem.start[None], later]), final, share


class _Field(TreeRecord):
    """The right-hand side over the share of the duration; the arrays that it closes over become
    arguments, through which derivatives flow."""

    function: Callable

    def __call__(self, share, y, _):
        return self.function(share, y)


def _adaptive(problem: Dynamics, numerics: Numerics, mesh: Mesh, record: bool):
    import diffrax  # late: runs on a mesh need none, and it takes half a second to load

    def right_hand_side(share, y):
        controls = [values_at(*item, share) for item in problem.controls]
        return problem.duration * problem.rate(y, problem.drive(*controls))

    closed = eqx.filter_closure_convert(right_hand_side, jnp.zeros(()), problem.start)
    # Control values jump or bend at the edges, and the solution at the event: no step across.
    breaks = jnp.asarray(mesh.piecewise.edges[1:-1])
    if problem.event is not None:
        breaks = jnp.sort(jnp.append(breaks, jax.lax.stop_gradient(problem.event)))
    control = diffrax.PIDController(rtol=numerics.tolerance, atol=numerics.tolerance)
    if len(breaks):
        control = diffrax.ClipStepSizeController(control, jump_ts=breaks)
    trajectory = [diffrax.SubSaveAt(ts=mesh.times())] if record else []
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_Field(closed)),  # pyright: ignore[reportArgumentType]
        diffrax.Kvaerno5() if problem.stiff else diffrax.Dopri8(),
        t0=0.0,
        t1=1.0,
        dt0=1e-6,
        y0=problem.start,
        stepsize_controller=control,
        saveat=diffrax.SaveAt(subs=[diffrax.SubSaveAt(t1=True), *trajectory]),
        adjoint=diffrax.RecursiveCheckpointAdjoint(),
        max_steps=numerics.max_steps,
        throw=False,
    )
    assert solution.ys is not None and solution.ts is not None
    final, states = solution.ys[0][-1], solution.ys[1] if record else None
    valid = (solution.result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(final))
    # Where the solver gave up, the last time saved is how far it came.
    return states, final, jnp.where(valid, 1.0, jnp.minimum(solution.ts[0][-1], 0.999))


# Of a state's size: residuals that add up to more are no solution. Of exponential decay this is a
# step of 1.2 time constants, with an error of 1.7 %.
LOOSE = 0.05


def too_long(problem: Dynamics, numerics: Numerics, track: Track) -> Float[Array, ""]:
    """The time in s at which the sum of the residuals of a `track` on the mesh first exceeds
    `LOOSE`; the duration if it never does."""
    mesh = make_mesh(
        edges_of(tuple(profile for profile, _ in problem.controls)), numerics.steps, problem.event
    )
    drive = problem.drive(*(mesh.values(*control) for control in problem.controls))
    step = (problem.duration * (mesh.stages[:, 2] - mesh.stages[:, 0]))[:, None]
    state = jnp.asarray(track.state)
    start, end, rate = state[:-1], state[1:], jax.vmap(problem.rate)
    first, last = rate(start, drive[:, 0]), rate(end, drive[:, 2])
    middle = (start + end) / 2 + step / 8 * (first - last)
    residual = step * (rate(middle, drive[:, 1]) + (first + last) / 4) - 1.5 * (end - start)
    lost = jnp.cumsum(jnp.abs(residual), axis=0)
    # The largest value of a state, which is of order one; for a state that grows without bound the
    # largest so far, so that the time is that of the onset.
    complete = jnp.minimum(1.0, jnp.max(jnp.abs(state), axis=0))
    size = jnp.maximum(jax.lax.cummax(jnp.abs(end)), complete)
    invalid = jnp.any(~(lost <= LOOSE * size) & (size > 0), axis=1)  # NaN is bad too
    when = mesh.stages[jnp.argmax(invalid), 0]
    return jnp.where(jnp.any(invalid), problem.duration * when, problem.duration)
