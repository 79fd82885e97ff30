"""Time steps with nodes where the solution has kinks, graded towards an event.

A fixed mesh converges to the derivatives of the solution only if no step straddles a kink. So the
mesh is broken at every profile node, and at the event (supersaturation crosses zero), which moves
with the parameters; derivatives include this movement. After the event, growth rises like a
fractional power of the time since then, so steps shrink towards it on both sides.
"""

from math import ceil
from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, Int, jnp

from .profile import Profile, values_in

GRADING = 3  # power of the grading: the error of derivatives falls like that of values


class PiecewiseTime(NamedTuple):
    """A unit's time, broken into K pieces at the nodes of its profiles and at its event.

    `breaks`: [K + 1] shares of the duration. `source`: [K] number of the interval of `edges` that
    contains the piece. `grading`: [K, 3] 1 at the row of `local_points` with which the steps of the
    piece are graded. `edges`: all nodes of the unit's profiles.
    """

    breaks: Float[Array, " K+1"]
    source: Int[Array, " K"]
    grading: Float[Array, "K 3"]
    edges: np.ndarray

    def of(self, profile: Profile) -> Int[Array, " K"]:
        """[K] the number of the profile's piece in which every piece of this time lies."""
        middle = (self.edges[:-1] + self.edges[1:]) / 2
        local = np.searchsorted(profile.share[1:-1], middle, side="right")
        return jnp.asarray(local)[self.source]

    def endpoints(self, profile: Profile, value) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        """The profile at the start and the end of each piece; in between it is linear."""
        local = self.of(profile)
        first = values_in(profile, value, local, self.breaks[:-1])
        return first, values_in(profile, value, local, self.breaks[1:])


class Mesh(NamedTuple):
    """n steps over one unit's time, in shares of its duration.

    `stages`: [n, 3] start, middle and end of each step. `piecewise`: the pieces that are divided
    into these steps.
    """

    stages: Float[Array, "n 3"]
    piecewise: PiecewiseTime

    def times(self) -> Float[Array, " n+1"]:
        """Shares of the duration at which the steps begin and end."""
        return jnp.concatenate([self.stages[:1, 0], self.stages[:, 2]])

    def values(self, profile: Profile, value: Float[Array, " N"]) -> Float[Array, "n 3"]:
        """The profile at every stage."""
        local, steps = self.piecewise.of(profile), len(self.stages) // len(self.piecewise.source)
        local = jnp.repeat(local, steps, total_repeat_length=len(self.stages))
        piece = jnp.broadcast_to(local[:, None], self.stages.shape)
        return values_in(profile, value, piece, self.stages)

    def point_values(self, profile: Profile, value) -> Float[Array, " n+1"]:
        """The profile at `times`; at a jump, the earlier value."""
        result = self.values(profile, value)
        return jnp.concatenate([result[:1, 0], result[:, 2]])


def edges_of(profiles: tuple[Profile, ...]) -> np.ndarray:
    """All nodes of the profiles, as shares of the duration."""
    return np.unique(np.concatenate([[0.0, 1.0], *(profile.share for profile in profiles)]))


def steps_per_piece(steps: int, segments: int) -> int:
    """The steps per piece: `steps` if there are few pieces; many pieces share about three times
    `steps`."""
    return steps if segments <= 4 else max(8, ceil(3 * steps / segments))


def local_points(n: int) -> Float[np.ndarray, "3 n+1"]:
    """Points from 0 to 1 in n steps, in three rows: equal steps, steps that shrink towards 1, and
    steps that grow from 0."""
    even = np.linspace(0.0, 1.0, n + 1)
    return np.stack([even, 1 - (1 - even) ** GRADING, even**GRADING])


def break_up(edges: np.ndarray, event: Float[Array, ""] | None) -> PiecewiseTime:
    """The pieces between the edges, and on both sides of an event at a share of the duration.

    Their number does not depend on where the event is: if the event is at an edge, one piece has
    length zero.
    """
    number = np.arange(len(edges) - 1 + (event is not None))
    if event is None:
        evenly = np.broadcast_to([1.0, 0.0, 0.0], (len(number), 3))
        return PiecewiseTime(jnp.asarray(edges), jnp.asarray(number), jnp.asarray(evenly), edges)
    position = jnp.sum(edges <= event)
    breaks = jnp.sort(jnp.append(jnp.asarray(edges), event))
    source = jnp.clip(jnp.where(number < position, number, number - 1), 0, len(edges) - 2)
    before, after = number == position - 1, number == position
    grading = jnp.stack([~(before | after), before, after], -1).astype(breaks.dtype)
    return PiecewiseTime(breaks, source, grading, edges)


def make_mesh(edges: np.ndarray, steps: int, event: Float[Array, ""] | None) -> Mesh:
    """A mesh with the same number of steps in every piece; the steps of a piece of length zero do
    no harm."""
    segments = break_up(edges, event)
    n = steps_per_piece(steps, len(segments.source))
    local = segments.grading @ local_points(n)
    points = segments.breaks[:-1, None] + jnp.diff(segments.breaks)[:, None] * local
    start, end = points[:, :-1], points[:, 1:]
    stages = jnp.stack([start, (start + end) / 2, end], -1).reshape(-1, 3)
    return Mesh(stages, segments)
