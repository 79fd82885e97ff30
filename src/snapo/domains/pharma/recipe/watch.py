"""An optimisation while it runs: its limits, the best point seen, and lines of progress."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..progress import say

if TYPE_CHECKING:
    from .optimum import Traced

SMALL = 1e-6  # a violation that counts as none when points are compared


class Limits(NamedTuple):
    """When an optimisation stops at the latest; `tell` takes its lines of progress, some seconds
    apart (those of the run at hand without one)."""

    evaluations: int = 5000
    seconds: float = float("inf")
    tell: Callable[[str], None] = say


class Stopped(Exception):
    """An optimisation that ends before its solver does; says why."""


class Watch:
    """What an optimisation has seen so far."""

    def __init__(self, traced: "Traced", limits: Limits, equalities: int):
        self.traced, self.limits, self.equalities = traced, limits, equalities
        self.before, self.began = traced.evaluations, time.perf_counter()
        self._best: tuple[tuple[float, float], np.ndarray] | None = None
        self._last = -1

    def see(self, u: np.ndarray, values: np.ndarray, goal: float) -> None:
        """A point with its numbers, the goal first and with the sign to make it small.

        **Raises:** `Stopped` at a limit, and where a number is not finite.
        """
        count = self.traced.evaluations - self.before
        if count == self._last:  # the same point, asked for again
            return
        self._last = count
        if not np.isfinite(values).all():
            raise Stopped(f"the function is not a number after {count} evaluations, so it stopped")
        rest = values[1:]
        wrong = np.concatenate([[0.0], np.abs(rest[: self.equalities]), -rest[self.equalities :]])
        violation = float(wrong.max())
        rank = (violation if violation > SMALL else 0.0, float(values[0]))
        if self._best is None or rank < self._best[0]:
            self._best = rank, np.array(u)
        self.limits.tell(
            f"evaluation {count}: goal {float(goal):.7g}, largest violation {violation:.1e}"
        )
        if count >= self.limits.evaluations:
            raise Stopped(f"it stopped after {count} evaluations")
        taken = time.perf_counter() - self.began
        if taken >= self.limits.seconds:
            raise Stopped(f"it stopped after {taken:.0f} s")

    def best(self, start: np.ndarray) -> np.ndarray:
        """The best point seen: least violation first, then the goal; the start where none was."""
        return start if self._best is None else self._best[1]
