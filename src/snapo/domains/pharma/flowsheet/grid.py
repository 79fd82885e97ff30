"""The grid of sizes on which crystals are counted, as part of the structure of a stream."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Grid:
    """`edges`: [N + 1] m, rising, of N cells; () of a stream that has no crystals."""

    edges: tuple[float, ...]

    @classmethod
    def of(cls, edges: np.ndarray) -> "Grid":
        return cls(tuple(float(edge) for edge in edges))

    @property
    def cells(self) -> int:
        return max(0, len(self.edges) - 1)

    @property
    def array(self) -> np.ndarray:
        return np.array(self.edges)


NO_CRYSTALS = Grid(())
# Of crystals of which only the moments are known there is no grid.
Sizes = Grid | None


def together(sizes: tuple[Sizes, ...]) -> Sizes:
    """On which grid crystals of several streams are counted together; None where they are not."""
    some = {size for size in sizes if size != NO_CRYSTALS}
    return NO_CRYSTALS if not some else some.pop() if len(some) == 1 else None
