"""Whether fixed steps were short enough: the residual of the differential equation between them.

For every step the cubic Hermite interpolant is inserted into the equation at the midpoint (Enright,
SIAM J. Numer. Anal. 1989). Where a step is too long for the fastest motion the residual is as large
as the state itself, even if the ends look smooth; elsewhere it falls with the fourth power of the
step.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .dynamics import Dynamics, Track
from .mesh import edges_of, make_mesh
from .numerics import Numerics

# Of a state's size: residuals that add up to more are no solution. Of exponential decay this is a
# step of 1.2 time constants, with an error of 1.7 %.
LOOSE = 0.05


def too_long(problem: Dynamics, numerics: Numerics, track: Track) -> Float[Array, ""]:
    """s at which the residuals of a `track` on the mesh first add up to more than `LOOSE`; the
    duration where they never do."""
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
