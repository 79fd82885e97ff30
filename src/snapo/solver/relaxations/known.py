"""The inner problem of a bound from above: given by a simulator, or known for its kind."""

from typing import Protocol, runtime_checkable

import numpy as np

from snapo.engine import Rollout
from snapo.problem.actions import Stop
from snapo.problem.noise import Draws
from snapo.problem.problem import Problem

from .stop import StopRelaxation


class Relaxation(Protocol):
    """The inner problem of a simulator: best decisions of one path in hindsight, penalised.

    - `terms`: how many parts the penalty has that can be scaled; 0 without a penalty.
    - `description`: the penalty in a phrase, for a report.
    """

    @property
    def terms(self) -> int: ...

    @property
    def description(self) -> str: ...

    def best(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        """[N] the most that each path can be worth to the objective, or more; penalties subtracted.

        `rollout` has the policy's states ("state": leaves [T, N, …]) and final states on the same
        paths, whose exogenous part is that of every policy; `scale` [terms] multiplies the
        penalty's parts (zeros: perfect foresight).
        """
        ...

    def charged(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        """[N] the penalties of the policy's own decisions: of mean zero."""
        ...


@runtime_checkable
class Relaxable(Protocol):
    """A simulator that knows its relaxation."""

    def relaxation(self, problem: Problem) -> Relaxation: ...


UNKNOWN = "its simulator has no method `relaxation` and is no stopping problem; see docs/bounds.md"


def bounded(problem: Problem) -> bool:
    """Whether `relaxation_of` knows one, as far as can be told without work."""
    return isinstance(problem.simulator, Relaxable) or isinstance(problem.action, Stop)


def relaxation_of(problem: Problem) -> Relaxation:
    """The relaxation of a simulator that has one, or of a problem whose only action is a `Stop`.

    **Raises:** `ValueError` where there is none; it says why.
    """
    if isinstance(problem.simulator, Relaxable):
        return problem.simulator.relaxation(problem)
    if isinstance(problem.action, Stop):
        return StopRelaxation(problem)
    raise ValueError(UNKNOWN)
