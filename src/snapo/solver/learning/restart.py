"""A training that goes on from another policy, with nothing remembered of the steps before."""

from dataclasses import replace

import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.problem import Problem

from ..limits.dual import Dual
from ..windows.critic import learner
from .optimiser import anew
from .progress import Progress
from .settings import TrainingPlan

MOST = 3  # times that a run whose rate nobody gave goes on after it broke, with a lower one


def may_be_slower(training: TrainingPlan, progress: Progress) -> bool:
    """Whether a rate that the problem chose may have led training astray: its first step did not
    break, nor its first value."""
    known = progress.step > 0 and np.isfinite(progress.best_value)
    return known and "learning_rate" in training.automatic and len(progress.slowed) < MOST


def slower(problem: Problem, training: TrainingPlan, progress: Progress) -> Progress:
    """On from the best policy so far, with a lower rate; the optimiser, the critic and the prices
    of limits, which the steps before led astray too, begin anew."""
    step = progress.step + 1
    moved = _begun_with(problem, training, progress, progress.best, step)
    return replace(moved, slowed=(*progress.slowed, step), status="training")


def redrawn(
    problem: Problem, training: TrainingPlan, progress: Progress, policy: Policy
) -> Progress:
    """On from another start, which the next validation values; the best so far stays known."""
    if progress.scale is not None:
        policy = progress.scale.plain(policy)
    moved = _begun_with(problem, training, progress, policy, progress.step)
    return replace(moved, halfway=policy, alike=0, redrawn=(*progress.redrawn, progress.step))


def _begun_with(
    problem: Problem, training: TrainingPlan, progress: Progress, policy: Policy, step: int
) -> Progress:
    """On from a policy after `step`."""
    critic = None if progress.window is None else learner(problem, training.seed)
    return replace(
        progress,
        step=step,
        policy=policy,
        average=policy,
        recent=policy,
        optimiser=anew(training, policy, progress.optimiser, 1),
        critic=critic,
        dual=Dual(),
        since=step,
    )
