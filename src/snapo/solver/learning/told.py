"""What training chose and why, in sentences for the notes of a solution."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from snapo.problem.policies.memory import remembering
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from ..verdict import idle
from . import clipping
from .growth import Growth
from .progress import Progress
from .settings import TrainingPlan
from .starts import describe


def recorded(problem: Problem, progress: Progress, training: TrainingPlan) -> Progress:
    """With the adjoints of the trained rule, where a user said how to go back and nothing else
    measured them."""
    values = isinstance(training.window, int), progress.clip is not None, progress.keep < 1
    if progress.growth is not None or not any(values):
        return progress
    smooth = Smooth(np.float32(training.temperature(progress.step)))
    problem = remembering(problem, progress.best)
    measured = clipping.measured(problem, progress.best, smooth, progress.step)
    return replace(progress, growth=Growth.of(measured, progress.step))


def start_notes(progress: Progress) -> tuple[str, ...]:
    """Which start went on, and where training began anew; by how much adjoints grow, where they do,
    and how training went back; the steps that broke."""
    raced = (describe(progress.raced),) if progress.raced else ()
    if progress.redrawn:
        raced = (*raced, idle.describe(progress.redrawn, progress.history))
    slowed = (_slowed(progress.slowed),) if progress.slowed else ()
    growth = progress.growth
    if growth is None or not growth.large:
        return raced + slowed
    return (*raced, f"{growth.describe()} {went_back(progress)}", *slowed)


def _slowed(steps: tuple[int, ...]) -> str:
    """One sentence on the steps that broke, after which the rate was lowered."""
    *first, last = map(str, steps)
    summary = f"steps {', '.join(first)} and {last}" if first else f"step {last}"
    return (
        f"Training broke at {summary}, where too many paths were not finite, and went on each time "
        "from the best policy so far with a quarter of the learning rate."
    )


def went_back(progress: Progress) -> str:
    """One sentence: windows, a bound or a decay of adjoints, and the step from which on."""
    history = progress.history
    if progress.window is not None:
        since = _before(record.window > 0 for record in history)
        return (
            f"From step {since} of the training on it went back through windows of "
            f"{progress.window} steps with a critic (Training(window=None) never does)."
        )
    ways = []
    clips = [record.clip > 0 for record in history]
    if any(clips) or progress.clip is not None:
        until, end = "", f", at {progress.clip or 0.0:,.3g} in the end"
        if progress.clip is None:
            lifted = len(clips) - _before(reversed(clips))
            until, end = f" to step {lifted}, after which they grew no more,", ""
        ways.append(
            f"from step {_before(clips)} of the training on{until} each path's own adjoint was "
            f"bounded{end} (Training(clip=None) never does)"
        )
    if progress.keep < 1:
        since = _before(record.keep < 1 for record in history)
        ways.append(
            f"from step {since} of the training on a share of {progress.keep:.3g} of it went on at "
            "every step back (Training(keep=1.0) keeps all)"
        )
    if not ways:
        return "Training did nothing about it; Training(clip=…) or Training(keep=…) would."
    summary = "; ".join(ways)
    return f"{summary[0].upper()}{summary[1:]}."


def _before(there: Iterable[bool]) -> int:
    """The number of steps before the first of which this is true."""
    return next((number for number, item in enumerate(there) if item), 0)
