"""Which path each lane of each block holds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Seats(NamedTuple):
    """The lanes of all blocks, part by part; the last path of a part fills its last block.

    - `path`: [blocks x lanes] the number of each lane's path; `own`: whether it counts there.
    - `edges`: [parts + 1] the first block of every part, and the number of all blocks.
    """

    path: np.ndarray
    own: np.ndarray
    edges: np.ndarray

    @classmethod
    def of(cls, sizes: Sequence[int], lanes: int) -> "Seats":
        """For parts of so many paths, which follow one another."""
        blocks = [-(-size // lanes) for size in sizes]
        starts = np.cumsum([0, *sizes[:-1]])
        seats = [np.arange(count * lanes) for count in blocks]
        path = [
            start + np.minimum(seat, size - 1) for start, seat, size in zip(starts, seats, sizes)
        ]
        own = [seat < size for seat, size in zip(seats, sizes)]
        return cls(np.concatenate(path), np.concatenate(own), np.cumsum([0, *blocks]))

    @property
    def blocks(self) -> int:
        """The number of all blocks."""
        return int(self.edges[-1])
