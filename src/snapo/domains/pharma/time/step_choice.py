"""The choice of a stiff unit's steps, by error control; and how stiff it is."""

from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, jax, jnp

from .dynamics import Dynamics
from .mesh import edges_of
from .rosenbrock import ORDER, rosenbrock
from .stiff import Steps, pushed, size_of_error

SAFETY, MINIMUM, MAXIMUM = 0.9, 0.1, 5.0  # of the step that the error estimate asks for
FIRST = 1e-6  # share of the duration that is tried first


class ChosenSteps(NamedTuple):
    """`end`: the ends of the steps as shares of the duration; only the first `count` are valid.
    `fastest`: the fastest response of any state in 1/s, from the norms of df/dy."""

    end: Float[Array, " most"]
    count: Array
    fastest: Float[Array, ""]


def choose(problem: Dynamics, tolerance: float, maximum: int) -> ChosenSteps:
    """Steps with errors of at most `tolerance`; at most `maximum` steps are tried. If they do not
    reach the end of the duration, the last number is the point that they reached. The result has no
    derivatives.
    """
    nodes = jnp.asarray(edges_of(tuple(profile for profile, _ in problem.controls)))

    def attempt(now):
        share, width, y, count, bumped, end, fastest = now
        number = jnp.clip(jnp.searchsorted(nodes, share, side="right") - 1, 0, len(nodes) - 2)
        node, to = nodes[number + 1], share + width
        to = jnp.where(to > node - 1e-3 * width, node, to)
        step = problem.duration * (to - share)
        after, error, jacobian = rosenbrock(
            problem.rate, y, step, pushed(problem, number, share, to)
        )
        size = size_of_error(error, y, after) / tolerance
        valid = size <= 1.0
        factor = SAFETY * jnp.maximum(size, 1e-12) ** (-1 / ORDER)
        factor = jnp.where(jnp.isfinite(factor), jnp.clip(factor, MINIMUM, MAXIMUM), MINIMUM)
        requested = factor * (to - share)
        # A step cut short at a node has little information about the next one.
        width = jnp.where(valid & (to == node), jnp.maximum(requested, width), requested)
        norms = [jnp.max(jnp.sum(jnp.abs(jacobian), axis)) for axis in (0, 1)]
        fastest = jnp.where(valid, jnp.maximum(fastest, jnp.minimum(*norms)), fastest)
        end = end.at[count].set(jnp.where(valid, to, end[count]))
        share, y = jnp.where(valid, to, share), jnp.where(valid, after, y)
        return share, width, y, count + valid, bumped + 1, end, fastest

    def more(now):
        share, width, _, _, tried, *_ = now
        return (share < 1.0) & (tried < maximum) & (share + width > share)

    zero, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
    now = (zero, zero + FIRST, problem.start, none, none, jnp.ones(maximum + 1), zero)
    *_, count, _, end, fastest = jax.lax.while_loop(more, attempt, now)
    return ChosenSteps(end, count, fastest)


def own_steps(problem: Dynamics, tolerance: float, maximum: int) -> Steps:
    """`maximum` steps for the present problem, in a trace; steps that are not needed have length
    zero. If the steps do not reach the end of the duration, a last step does, which its error
    estimate refuses. The result has no derivatives."""

    def endpoints(start, duration):
        return choose(problem._replace(start=start, duration=duration), tolerance, maximum - 1).end

    # The numbers that rate and drive close over become arguments, so that theirs can be stopped.
    converted, held = jax.closure_convert(endpoints, problem.start, problem.duration)
    values = jax.lax.stop_gradient((problem.start, problem.duration, *held))
    end = jax.lax.stop_gradient(converted(*values))
    start = jnp.append(0.0, end[:-1])
    edges = edges_of(tuple(profile for profile, _ in problem.controls))
    number = jnp.searchsorted(jnp.asarray(edges), start, side="right") - 1
    return Steps(start, end, jnp.clip(number, 0, len(edges) - 2))


def times_of(selected: ChosenSteps) -> Float[np.ndarray, " n+1"]:
    """The times of the steps, as shares of the duration. If the steps did not reach the end of the
    duration, a last step does, which its error estimate refuses."""
    return np.unique(
        np.concatenate([[0.0], np.asarray(selected.end)[: int(selected.count)], [1.0]])
    )
