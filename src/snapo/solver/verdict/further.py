"""The gain of more steps, and the possible gain of any policy.

The gain of more steps is that of the second half of a training, extrapolated.

A training's rate rises in the warm-up and falls to zero, so that late steps hardly change whether
or not there is something left to gain. Gains are therefore measured over the sum of the rates, the
distance that a training can cover, and not over its steps. The shortfall is assumed inversely
proportional to it: a training with a cosine schedule whose second half gained 1 would gain 2.25
with as many further steps. For eight problems with a known optimum this gain was between 1 and 4.

It also tests whether a decision is in effect a stopping decision that is not written with `Stop`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Actions, Box, Choice, Integers, Stop
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from ..learning.optimiser import rates
from ..learning.progress import Progress
from ..learning.settings import TrainingPlan


def ends_for_good(problem: Problem) -> bool:
    """Whether one extreme of the only decision takes a flag of the state from 1 to 0, or from 0 to
    1, permanently, while the other one leaves it unchanged: exercise of an option, closure of a
    plant. It is tested from the initial state, with all noise zero.
    """
    extremes = _extremes(problem.action)
    if extremes is None:
        return False
    # Arrays of JAX, as in an engine: user code may index them as such.
    simulator, schedule = problem.simulator, jax.tree.map(jnp.asarray, problem.schedule)
    noise = jnp.zeros(simulator.noise_size)
    now = at(schedule.steps, 0)

    @jax.jit
    def after(state, action):
        return simulator.step(schedule.constants, now, state, action, noise, Exact())[0]

    start = jnp.zeros(simulator.initial_noise_size)
    first = jax.jit(lambda: simulator.initial(schedule.constants, start))()
    for stop, go in (extremes, extremes[::-1]):
        stopped = after(first, stop)
        later = [after(stopped, action) for action in extremes]
        states = [_numbers(item) for item in (first, after(first, go), stopped, *later)]
        if any(_is_flag(*leaves) for leaves in zip(*states)):
            return True
    return False


def _extremes(action: Actions) -> tuple[np.ndarray, np.ndarray] | None:
    """The two ends of a decision of one number, or the two options of a choice; None elsewhere."""
    if isinstance(action, Choice) and action.size == 2:
        return np.array([1.0, 0.0]), np.array([0.0, 1.0])
    low, high = action.bounds()
    one = isinstance(action, Box | Integers) and not isinstance(action, Stop) and action.size == 1
    return (low, high) if one and np.isfinite(high - low).all() else None


def _numbers(state) -> list[np.ndarray]:
    return [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(state)]


def _is_flag(first, gone_on, stopped, *later) -> bool:
    """Whether a number of the state is 0 or 1, and changes only once, by a stop."""
    if first.size != 1 or first.item() not in (0.0, 1.0):
        return False
    selected = gone_on == first and all(item == stopped for item in later)
    return bool(selected and stopped == 1.0 - first)


SIGNIFICANT = 2.0  # standard errors
SHARE = 0.01  # of the size: as many steps again would bring more
UNSURE = 0.03  # of the size: two errors above this are inconclusive
WARMUPS = 5  # a training of fewer warm-ups than this is inconclusive
SETTLED = 2.0  # times its noise: a gradient norm below it may be that of an optimum
MATTERS = 0.001  # of the size: the gain of a gradient step of the length of the second half


class Further(NamedTuple):
    """The expected gain of as many further steps.

    - `late`, `late_error`: the gain of the last part of the training on the same paths, and its
      error.
    - `times`: the factor from this gain to the expected one; `size`: the scale of the gains.
    """

    late: float
    late_error: float
    times: float
    size: float

    @property
    def more(self) -> float:
        """The expected gain of as many further steps."""
        return self.times * self.late

    @property
    def improving(self) -> bool:
        """Whether this gain is large and significant."""
        return self.late > SIGNIFICANT * self.late_error and self.more > SHARE * self.size

    @property
    def is_small(self) -> bool:
        """Whether the gain is significantly small, in either direction."""
        wide = SIGNIFICANT * self.times * self.late_error
        return bool(abs(self.more) <= SHARE * self.size and wide <= UNSURE * self.size)


def compared_step(progress: Progress, training: TrainingPlan) -> int:
    """The step of `Progress.halfway`, or that at which training restarted since."""
    marks = [training.steps >> k for k in range(training.steps.bit_length())]
    reached = [mark for mark in marks if mark <= progress.step]
    began = progress.redrawn[-1] if progress.redrawn else 0
    return max(reached[1] if len(reached) > 1 else 0, began)


def times_of(progress: Progress, training: TrainingPlan) -> float:
    """The factor on the gain since `compared_step`; at least 1.

    If the shortfall is c / way, that gain is c / half - c / way, and training for twice the way
    gains c / (2 way).
    """
    half = _way(training, compared_step(progress, training))
    path = _way(training, progress.step)
    return max(1.0, 0.5 * half / (path - half)) if path > half else 1.0


def too_short(training: TrainingPlan, step: int) -> bool:
    """Whether this number of steps is inconclusive: the warm-up is a large part of them."""
    return step < WARMUPS * training.warmup


def restless(norm: float, noise: float, path: float, size: float) -> bool:
    """Whether the policy's gradient is significantly not zero, so that a gain is possible.

    Without noise this cannot be decided: at a kink of the smooth value it is not zero either.
    """
    available = np.isfinite([norm, noise]).all() and noise > 0
    return bool(available and norm > SETTLED * noise and norm * path > MATTERS * size)


def _way(training: TrainingPlan, step: int) -> float:
    """The sum of the rates of the steps before this one."""
    return float(np.sum(rates(training, step)))


NEAR = 0.005  # of the bound: nothing is left that a longer training should look for
OPTIMUM = "the optimum is at most"
USEFUL = 0.05  # of the bound: one that leaves more room is no evidence on a training


class Room(NamedTuple):
    """The maximum share of a value that can be gained, and the sentence on it."""

    share: float
    description: str

    @property
    def near(self) -> bool:
        """Whether this share is negligible."""
        return self.share <= NEAR


def room(
    value: float | None,
    error: float | None,
    bounds: Mapping[str, Any] | None = None,
    exact: float | None = None,
) -> Room | None:
    """The known bounds of a value; None if there are none, or none tighter than `USEFUL`.

    - `bounds`: in the form of `Bound.row`; `exact`: the exact value, which no policy exceeds.
    """
    results = [_below_exact(value, error, exact), _below_bound(bounds)]
    available = [item for item in results if item is not None and item.share <= USEFUL]
    return min(available, key=lambda entry: entry.share) if available else None


def _below_exact(value, error, exact) -> Room | None:
    if value is None or not exact or not np.isfinite([value, exact]).all():
        return None
    share = max(0.0, (exact - value + SIGNIFICANT * (error or 0.0)) / abs(exact))
    return Room(share, f"{_at_most(share)}: the exact value is {exact:,.6g}.")


def _below_bound(bounds) -> Room | None:
    if not bounds:
        return None
    gap, upper = bounds["gap"]["high"], bounds["upper"]
    if None in (gap, upper["value"], upper["high"]) or not upper["value"] or not np.isfinite(gap):
        return None
    share = max(0.0, gap / abs(upper["value"]))
    return Room(share, f"{_at_most(share)}: {OPTIMUM} {upper['high']:,.6g} (95 %).")


def _at_most(share: float) -> str:
    if share == 0:
        return "Nothing can be gained over this policy"
    return f"At most {100 * share:.2g} % can be gained over this policy"
