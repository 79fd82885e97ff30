"""What more steps would bring: the gain of the second half of a training, extrapolated.

A training's rate rises in the warm-up and falls to zero, so that late steps change little whether
or not there is something left to gain. Gains are therefore seen over the sum of the rates, the way
that a training can go, and not over its steps. Along it the shortfall falls like one over the way:
a training of a cosine whose second half gained 1 would gain 2.25 with as many steps again. Eight
problems of known course were between 1 and 4.
"""

from typing import NamedTuple

import numpy as np

from ..learning.optimiser import schedule
from ..learning.progress import Progress
from ..learning.settings import TrainingPlan

SIGNIFICANT = 2.0  # standard errors
SHARE = 0.01  # of the size: as many steps again would bring more
UNSURE = 0.03  # of the size: two errors above this tell nothing
WARMUPS = 5  # a training of fewer warm-ups than this tells nothing
SETTLED = 2.0  # times its noise: a gradient norm below it may be that of an optimum
MATTERS = 0.001  # of the size: what a gradient could bring over the way of the second half


class Further(NamedTuple):
    """What as many steps again would bring.

    - `late`, `late_error`: the gain of the last part of the training, on the same paths.
    - `times`: by how much that is multiplied; `size`: what counts as all.
    """

    late: float
    late_error: float
    times: float
    size: float

    @property
    def more(self) -> float:
        """What as many steps again would bring."""
        return self.times * self.late

    @property
    def improving(self) -> bool:
        """Whether that is much, and sure."""
        return self.late > SIGNIFICANT * self.late_error and self.more > SHARE * self.size

    @property
    def is_small(self) -> bool:
        """Whether it is surely not much, in either direction."""
        wide = SIGNIFICANT * self.times * self.late_error
        return bool(abs(self.more) <= SHARE * self.size and wide <= UNSURE * self.size)


def compared_step(progress: Progress, training: TrainingPlan) -> int:
    """The step of `Progress.halfway`, or that at which training began anew since."""
    marks = [training.steps >> k for k in range(training.steps.bit_length())]
    reached = [mark for mark in marks if mark <= progress.step]
    began = progress.redrawn[-1] if progress.redrawn else 0
    return max(reached[1] if len(reached) > 1 else 0, began)


def times(progress: Progress, training: TrainingPlan) -> float:
    """What the gain since `compared_step` is multiplied by; at least 1.

    With a shortfall of c / way, that gain is c / half - c / way, and twice the way gains c / 2 way.
    """
    half = _way(training, compared_step(progress, training))
    path = _way(training, progress.step)
    return max(1.0, 0.5 * half / (path - half)) if path > half else 1.0


def too_short(training: TrainingPlan, step: int) -> bool:
    """Whether so many steps tell nothing: the warm-up is a large part of them."""
    return step < WARMUPS * training.warmup


def restless(norm: float, noise: float, path: float, size: float) -> bool:
    """Whether the policy's gradient is surely not zero, and could still bring something.

    Without noise nothing says so: at a bend of the smooth value it is not zero either.
    """
    available = np.isfinite([norm, noise]).all() and noise > 0
    return bool(available and norm > SETTLED * noise and norm * path > MATTERS * size)


def _way(training: TrainingPlan, step: int) -> float:
    """The sum of the rates of the steps before this one."""
    rates = np.asarray(schedule(training)(np.arange(max(1, step))))
    return float(np.sum(rates[:step]))
