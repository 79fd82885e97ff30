"""What was seen of a real environment: transitions, and the first observations of episodes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

MINIMUM = 1e-6  # of a scale, as a share of the size of its numbers
ON_CIRCLE = 1e-3  # of the sum of two squares, at every observation


class Transitions(NamedTuple):
    """Steps of the environment, one a row; with `hold`, a step is that of a held decision.

    `ended` is true where the environment terminated: nothing comes after. The limit of time is no
    such end, since it says nothing about the state.
    """

    before: Float[np.ndarray, "n k"]
    action: Float[np.ndarray, "n m"]
    reward: Float[np.ndarray, " n"]
    after: Float[np.ndarray, "n k"]
    ended: Bool[np.ndarray, " n"]

    @property
    def count(self) -> int:
        return self.before.shape[0]


def joined(parts: list[Transitions]) -> Transitions:
    """All of them, in their order."""
    return Transitions(*(np.concatenate(part) for part in zip(*parts)))


def circles(observed: Float[np.ndarray, "n k"]) -> tuple[tuple[int, int], ...]:
    """Pairs of observed numbers that lie on the unit circle in all rows: cosine and sine.

    A model that leaves the circle by a little every step asks its networks about states that no
    environment has; so such pairs are put back on it.
    """
    pairs: list[tuple[int, int]] = []
    free = list(range(observed.shape[1]))
    while free:
        i = free.pop(0)
        for j in free:
            on = np.abs(observed[:, i] ** 2 + observed[:, j] ** 2 - 1) < ON_CIRCLE
            moves = min(np.ptp(observed[:, i]), np.ptp(observed[:, j])) > ON_CIRCLE
            if on.all() and moves:
                pairs.append((i, j))
                free.remove(j)
                break
    return tuple(pairs)


def scale_of(
    rows: Float[np.ndarray, "n k"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and deviation of columns; a column that never moves has a scale of one."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.ones(rows.shape[1])
    mean, deviation = rows.mean(0), rows.std(0)
    still = deviation <= MINIMUM * np.maximum(np.abs(mean), 1e-30)
    return mean, np.where(still, 1.0, deviation)
