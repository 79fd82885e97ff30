"""How adjoints grow on their way back, by step and by part of the state: a record, and in words."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from snapo.engine.norms import Norms

TAME = 100.0  # times: less growth than this needs no word


class Growth(NamedTuple):
    """Norms of the adjoint before every step, of a few paths of training, at one policy.

    - `step`: of training, at which they were measured.
    - `usual`, `largest`: [T] the median over the paths, and the largest of them.
    - `leaves`: {name: [T]} the root mean square over the paths, by part of the state.
    """

    step: int
    usual: tuple[float, ...]
    largest: tuple[float, ...]
    leaves: Mapping[str, tuple[float, ...]]

    @property
    def times(self) -> float:
        """How many times as large the largest is as before the last step."""
        return max(self.largest) / max(self.largest[-1], np.finfo(float).tiny)

    @property
    def large(self) -> bool:
        """Whether a reader must know of it: a hundredfold growth, from which on training looks for
        windows or a bound. Where a step's worth is added to the adjoint at every step back and
        nothing grows, it is as many times as large as there are such steps."""
        return self.times > TAME

    def describe(self) -> str:
        """One sentence: by how much they grow, at which step and in which part of the state."""
        largest, times = np.asarray(self.largest), self.times
        position = int(np.argmax(largest))
        if not self.large:
            return f"Adjoints grow {times:,.3g}-fold on their way back: no more than usual."
        half = _explodes(largest, position)
        state = max(self.leaves, key=lambda name: self.leaves[name][position], default="state")
        apart = largest[position] / max(self.usual[position], np.finfo(float).tiny)
        return (
            f"Adjoints grow {times:,.2g}-fold on their way back from the last step to step "
            f"{position} of {largest.size}, a hundredfold before step {half}, most in the state "
            f"{state!r}; there the largest of the paths is {apart:,.2g} times the usual one."
        )

    def table(self) -> list[tuple]:
        """Rows: the step, the usual and the largest norm, and that of every part of the state."""
        return list(zip(range(len(self.usual)), self.usual, self.largest, *self.leaves.values()))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns of `table`."""
        return ("step", "usual", "largest", *self.leaves)

    @classmethod
    def of(cls, norms: Norms, step: int) -> "Growth":
        """The record of norms that were measured at a step of training."""
        leaves = {name: _root_mean_square(leaf) for name, leaf in norms.leaves.items()}
        return cls(step, _row(np.median(norms.total, 1)), _row(norms.total.max(1)), leaves)

    @classmethod
    def read(cls, stored) -> "Growth | None":
        """From plain data, as JSON gives it."""
        if stored is None:
            return None
        step, usual, largest, leaves = stored
        leaves = {name: tuple(leaf) for name, leaf in leaves.items()}
        return cls(int(step), tuple(usual), tuple(largest), leaves)


def _explodes(largest: np.ndarray, position: int) -> int:
    """The step from which on adjoints, on their way back to `position`, exceed the limit."""
    over = largest[position:] > TAME * largest[-1]
    return position + int(np.flatnonzero(over)[-1])


def _root_mean_square(norms: np.ndarray) -> tuple[float, ...]:
    return _row(np.sqrt(np.mean(np.asarray(norms, float) ** 2, axis=1)))


def _row(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(float(f"{number:.6g}") for number in numbers)
