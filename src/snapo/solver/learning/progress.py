"""The state of a training, from which a stopped run can continue."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import PyTree

from snapo.problem.policies.memory import remembering
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem

from ..limits import Dual
from .conditioning import Growth
from .features import FeatureScale
from .optimiser import initial_state, restarted
from .settings import Training, TrainingPlan, resolve_auto
from .windows import UPDATES, Learner, learner

SLOWER = 0.25  # of the rate, after a step that broke
MAX_SLOWED = 3  # times that a failed run continues at a lower rate, if no rate is specified


INTERRUPTED = "interrupted"  # status of a training that Ctrl-C has ended


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during work that is partly done.

    - `result`: the part done: a `Progress`, a `Solution`, or the tables of a run's part.
    - `notes`: sentences on callbacks that failed after the interrupt.
    """

    def __init__(self, result: Any, notes: tuple[str, ...] = ()):
        super().__init__()
        self.result, self.notes = result, notes


class Record(NamedTuple):
    """One line of the training history; `exact` and `best` are those of the last validation.

    `window`: the length of the windows for backpropagation; 0: the whole horizon. `exact_error`:
    the standard error of `exact`, in the line of its validation; 0 elsewhere. `clip`, `keep`: the
    bound on each path's adjoint in the step (0: none), and the share of the adjoint that is passed
    on at every backward step.
    """

    step: int
    objective: float
    gradient_norm: float
    temperature: float
    bad_paths: int
    exact: float
    best: float
    seconds: float
    window: int = 0
    exact_error: float = 0.0
    clip: float = 0.0
    keep: float = 1.0


class Round(NamedTuple):
    """A comparison of several starts at one step: the exact value of each start that is still
    trained. `values`: pairs (number of the start from 0, value), the best one first.
    """

    step: int
    values: tuple[tuple[int, float], ...]

    @classmethod
    def read(cls, stored) -> "Round":
        """The record from its plain data, as read from JSON."""
        step, values = stored
        return cls(step, tuple((number, value) for number, value in values))


@dataclass(frozen=True)
class Progress:
    """The complete state of the training loop, from which a stopped run can continue.

    `halfway` and `recent` are averaged policies at the last two steps of the series …, steps / 4,
    steps / 2, steps that have been reached. Whenever a run stops, the first of them is therefore
    from its second quarter or its middle. `window`, `critic`: the length and the critic of training
    on windows, specified or chosen. `clip` is the current bound, if any, and `keep` the share;
    `since` the step at which the optimiser began, or restarted after exploding gradients. `growth`:
    the adjoints, if they were measured. `dual`: the prices of the problem's limits. `raced`: the
    rounds in which starts were dropped, if there were several. `slowed`: the steps that failed,
    after each of which the rate is lower (see `train`). `redrawn`: the steps at which it restarted
    from other initial weights (see `verdict.constant`); `unchanged`: the validations in a row in
    which every path earned the same. `scale`: the scale of the features that no decision affects,
    for which the first layer is trained.
    """

    step: int
    policy: Policy
    average: Policy
    best: Policy
    halfway: Policy
    recent: Policy
    optimiser: PyTree
    best_value: float
    stale: int
    history: tuple[Record, ...]
    status: str
    critic: Learner | None = None
    window: int | None = None
    clip: float | None = None
    keep: float = 1.0
    since: int = 0
    growth: Growth | None = None
    dual: Dual = Dual()
    raced: tuple[Round, ...] = ()
    slowed: tuple[int, ...] = ()
    redrawn: tuple[int, ...] = ()
    unchanged: int = 0
    scale: FeatureScale | None = None

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """One line: `callbacks=[print]` prints it at every validation."""
        if not self.history:
            return f"step {self.step:>5}"
        last = self.history[-1]
        return (
            f"step {last.step:>5}: exact value {last.exact:>14,.7g}, best {last.best:>14,.7g}, "
            f"{last.seconds:6.1f} s"
        )

    @property
    def restarted(self) -> int:
        """The last step after which training continued with a lower rate; 0: none."""
        return self.slowed[-1] if self.slowed else 0

    def rate(self, training: TrainingPlan) -> float:
        """The highest rate of the schedule in force."""
        return training.learning_rate * SLOWER ** len(self.slowed)

    @property
    def last_two(self) -> tuple[float, float] | None:
        """The exact values of the last two starts of a race at the same step, the better one first;
        None without a race. Their distance shows the effect of the start on the value."""
        if not self.raced:
            return None
        (_, better), (_, other) = self.raced[-1].values
        return better, other

    @property
    def record(self) -> Record:
        """The line of the last step taken."""
        return self.history[-1]


def marks(step: int, steps: int) -> bool:
    """Whether a step is one of steps, steps / 2, steps / 4, …, rounded down (see `Progress`)."""
    return step in (steps >> k for k in range(steps.bit_length()))


def initial_progress(
    policy: Policy, training: Training, problem: Problem | None = None
) -> Progress:
    """The state before the first step; training on windows needs the problem, for its critic."""
    if problem is not None:
        training = resolve_auto(training, problem, policy)
    plan = training if isinstance(training, TrainingPlan) else TrainingPlan.of(training)
    values = training.clip if isinstance(training.clip, int | float) else None
    keep = training.keep if isinstance(training.keep, int | float) else 1.0
    window, critic = None, None
    if isinstance(training.window, int):
        if problem is None:
            raise ValueError("begin: if training has a window, pass the problem too.")
        if problem.constraints:
            raise ValueError("begin: windows do not support constraints; use window=None.")
        if training.window < problem.simulator.horizon:
            window, critic = training.window, learner(remembering(problem, policy), training.seed)
    state = initial_state(plan, policy, UPDATES if window else 1)
    same = dict.fromkeys(("policy", "average", "best", "halfway", "recent"), policy)
    empty = {"best_value": float("-inf"), "stale": 0, "history": (), "status": "training"}
    return Progress(
        step=0,
        **same,
        optimiser=state,
        **empty,
        critic=critic,
        window=window,
        clip=values,
        keep=keep,
    )


def may_be_slower(training: TrainingPlan, progress: Progress) -> bool:
    """Whether an automatic learning rate may have caused the failure: the first step and the first
    value were finite."""
    available = progress.step > 0 and np.isfinite(progress.best_value)
    return available and "learning_rate" in training.automatic and len(progress.slowed) < MAX_SLOWED


def go_slower(problem: Problem, training: TrainingPlan, progress: Progress) -> Progress:
    """Continues from the best policy so far, with a lower rate; the optimiser, the critic and the
    dual variables of the limits, which the failed steps affected too, restart."""
    step = progress.step + 1
    moved = _begun_with(problem, training, progress, progress.best, step)
    return replace(moved, slowed=(*progress.slowed, step), status="training")


def begin_again(
    problem: Problem, training: TrainingPlan, progress: Progress, policy: Policy
) -> Progress:
    """Continues from another start, which the next validation values; keeps the best so far."""
    if progress.scale is not None:
        policy = progress.scale.plain(policy)
    moved = _begun_with(problem, training, progress, policy, progress.step)
    return replace(moved, halfway=policy, unchanged=0, redrawn=(*progress.redrawn, progress.step))


def _begun_with(
    problem: Problem, training: TrainingPlan, progress: Progress, policy: Policy, step: int
) -> Progress:
    """The state that continues from a policy after `step`."""
    critic = None if progress.window is None else learner(problem, training.seed)
    return replace(
        progress,
        step=step,
        policy=policy,
        average=policy,
        recent=policy,
        optimiser=restarted(training, policy, progress.optimiser, 1),
        critic=critic,
        dual=Dual(),
        since=step,
    )


def last_calls(
    callbacks: Sequence[Callable[[Progress], object]], progress: Progress
) -> tuple[str, ...]:
    """Calls the callbacks after an interrupt; the error of a callback that fails becomes a note."""
    notes = []
    for callback in callbacks:
        try:
            callback(progress)
        except Exception as error:
            name = getattr(callback, "__name__", type(callback).__name__)
            notes.append(f"The callback {name} failed: {type(error).__name__}: {error}.")
    return tuple(notes)


def stopped(progress: Progress) -> Progress:
    """The end of training that a callback requests."""
    going = progress.status == "training"
    return replace(progress, status="stopped early") if going else progress
