"""Time steps that are broken where the solution has kinks, and graded towards an event.

A fixed mesh converges to the derivatives of the solution only if no step straddles a kink. So
the mesh is broken at every profile node, and at the event (supersaturation crosses zero), which
moves with the parameters and is differentiated with them. Growth starts there like a broken
power of the time since, hence steps that shrink towards it on both sides.
"""

from math import ceil
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .profile import values_in
from .records_units import Profile

GRADING = 3  # power of the grading: the error of derivatives falls like that of values


class Mesh(NamedTuple):
    """n steps over one unit's time, in shares of its duration.

    `stages`: [n, 3] start, middle and end of each step. `piece`: [n] number of the interval of
    `edges` in which the step lies. `edges`: all nodes of the unit's profiles.
    """

    stages: Float[Array, "n 3"]
    piece: Int[Array, " n"]
    edges: np.ndarray

    def times(self) -> Float[Array, " n+1"]:
        """Shares of the duration at which the steps begin and end."""
        return jnp.concatenate([self.stages[:1, 0], self.stages[:, 2]])

    def piece_of(self, profile: Profile) -> Int[Array, " n"]:
        """The number of the profile's own piece in which each step lies."""
        return jnp.asarray(_pieces(profile, self.edges))[self.piece]

    def values(self, profile: Profile, value: Float[Array, " N"]) -> Float[Array, "n 3"]:
        """The profile at every stage."""
        piece = jnp.broadcast_to(self.piece_of(profile)[:, None], self.stages.shape)
        return values_in(profile, value, piece, self.stages)

    def point_values(self, profile: Profile, value) -> Float[Array, " n+1"]:
        """The profile at `times`, at a jump the earlier value."""
        found = self.values(profile, value)
        return jnp.concatenate([found[:1, 0], found[:, 2]])


def edges_of(profiles: tuple[Profile, ...]) -> np.ndarray:
    """All nodes of the profiles, as shares of the duration."""
    return np.unique(np.concatenate([[0.0, 1.0], *(each.share for each in profiles)]))


def steps_per_piece(steps: int, pieces: int) -> int:
    """`steps` in each of a few pieces; many pieces share about three times as many."""
    return steps if pieces <= 4 else max(8, ceil(3 * steps / pieces))


def make_mesh(edges: np.ndarray, steps: int, event: Float[Array, ""] | None) -> Mesh:
    """Steps between the edges, and on both sides of an event at a share of the duration.

    The number of steps does not depend on where the event is: next to an edge, a piece of length
    zero has steps of length zero, which do no harm.
    """
    pieces = len(edges) - 1 + (event is not None)
    n = steps_per_piece(steps, pieces)
    even = np.linspace(0.0, 1.0, n + 1)
    number = np.arange(pieces)
    if event is None:
        breaks, source = jnp.asarray(edges), jnp.asarray(number)
        local = jnp.broadcast_to(jnp.asarray(even), (pieces, n + 1))
    else:
        position = jnp.sum(edges <= event)
        breaks = jnp.sort(jnp.append(jnp.asarray(edges), event))
        source = jnp.clip(jnp.where(number < position, number, number - 1), 0, len(edges) - 2)
        before, after = (number == position - 1)[:, None], (number == position)[:, None]
        after_event = jnp.where(after, even**GRADING, even)
        local = jnp.where(before, 1 - (1 - even) ** GRADING, after_event)
    points = breaks[:-1, None] + jnp.diff(breaks)[:, None] * local
    start, end = points[:, :-1], points[:, 1:]
    stages = jnp.stack([start, (start + end) / 2, end], -1).reshape(-1, 3)
    return Mesh(stages, jnp.repeat(source, n, total_repeat_length=pieces * n), edges)


def _pieces(profile: Profile, edges: np.ndarray) -> np.ndarray:
    """[edges - 1] the profile's own piece that holds each interval between edges."""
    middle = (edges[:-1] + edges[1:]) / 2
    return np.searchsorted(profile.share[1:-1], middle, side="right")
