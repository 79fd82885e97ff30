"""Trainings that end at doing nothing: every path earns the same, whatever is random.

A store that never buys has nothing to sell, and one that never sells has no use for what it buys:
no gradient leads out of there, from whichever side a training got in. It is seen by validations
that are worth the same number on every path. Training then begins anew from other first weights,
with a part of every decision drawn at random, so that it meets what a rule that does nothing never
sees.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from snapo.problem.actions import Actions
from snapo.problem.objective import Totals
from snapo.problem.problem import Problem

from ..learning.progress import Progress, Record
from ..learning.settings import TrainingPlan

MAXIMUM = 3  # times that a training begins anew
DRAWN = 0.3  # of every decision, at random, in one that began anew
LAST = 0.5  # of the steps: later on too few are left
NONE = 1e-9  # of a total: a difference that is round-off


def equal_on_all_paths(problem: Problem, totals: Totals) -> bool:
    """Whether every path has the same totals of the objective, although paths are random.

    An error of zero does not say so: antithetic pairs have none where noise counts linearly.
    """
    results = [np.asarray(totals[name]) for name in problem.objective.outputs]
    return problem.is_random and all(
        np.isfinite(total).all() and np.ptp(total) <= NONE * np.max(np.abs(total))
        for total in results
    )


def caught(progress: Progress, training: TrainingPlan) -> bool:
    """Whether training should begin anew: the last two validations say that it does nothing."""
    early = progress.step <= LAST * training.steps and progress.status == "training"
    return progress.unchanged >= 2 and early and len(progress.redrawn) < MAXIMUM


def exploring(training: TrainingPlan, action: Actions) -> TrainingPlan:
    """The training with more of every decision drawn, where decisions have bounds."""
    bounded = all(np.isfinite(bound).all() for bound in action.bounds())
    if not (bounded and action.exploration_size and training.cools):
        return training
    return replace(training, exploration=max(training.exploration, DRAWN))


def describe(steps: Sequence[int], history: Sequence[Record]) -> str:
    """One sentence on the steps at which training began anew."""
    *first, last = map(str, steps)
    where = f"steps {', '.join(first)} and {last}" if first else f"step {last}"
    value = history[steps[0] - 1].exact
    return (
        f"Training began anew from other first weights at {where}, since every path earned the "
        f"same ({value:,.6g})."
    )


def advice(value: float) -> str:
    """One sentence where the trained rule does nothing."""
    return (
        f"Every path earns the same ({value:,.6g}): the decisions do nothing with what is random. "
        "If that is not meant, try another seed, a wider exploration (exploration=0.4), or a rule "
        "to begin from (snapo.Residual)."
    )
