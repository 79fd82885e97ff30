"""Training: stochastic gradient ascent on the smooth simulator, one adjoint pass per step.

`train` is a plain loop. Adam with warm-up and cosine decay maximises the objective; the temperature
of the constraints is annealed; the parameters are averaged; the averaged policy is validated on the
EXACT simulator and the best one is kept. The fresh scenarios of every step are a function of seed
and step, so a stopped run continues bit for bit from its `Progress`.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import PyTree

from snapo.engine import BoundEngine, Clip, Engine
from snapo.problem.code.version import reading_once
from snapo.problem.policies.memory import remembering
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact, Smooth

from .adjoint import DROPPED, adjoint_of_finite_paths, float64
from .evaluate import estimate, value_of
from .learning.bar import ProgressLine
from .learning.conditioning import (
    EARLY,
    FIRST,
    Growth,
    clip_level,
    due,
    fell_for_good,
    grows,
    has_fallen,
    has_leapt,
    is_chaotic,
    is_held_down,
    sampled_norms,
    share_kept,
    short_memory_norms,
    window_length,
)
from .learning.optimiser import initial_state, memory, restarted, updater
from .learning.practice import perturbed_problem
from .learning.progress import (
    Interrupted,
    Progress,
    Record,
    begin_again,
    go_slower,
    last_calls,
    marks,
    may_be_slower,
    stopped,
)
from .learning.progress import initial_progress as initial_progress
from .learning.settings import Training as Training
from .learning.settings import TrainingPlan, resolve_auto
from .learning.windows import UPDATES, Learner, has_worth_ahead, learner, sweep, window_adjoint
from .limits import Dual
from .limits import updated_prices as moved_prices
from .verdict.constant import caught, equal_on_all_paths, exploring

DIVERGED_SHARE = 0.05  # more than this share of a step's paths non-finite: the run has diverged

Callback = Callable[[Progress], object]  # one that returns True stops the training


class TrainingLoop(NamedTuple):
    """Everything that one step of training needs; `update` is the compiled step of the optimiser.
    - `problem`, `bound_engine`: the problem whose objective a step uses, which is perturbed with a
    `spread` or `exploration`; the unperturbed problem is `inner`, which `exact` simulates.
    """

    problem: Problem
    training: TrainingPlan
    bound_engine: BoundEngine
    inner: Problem
    exact: BoundEngine
    update: Callable
    update_by_windows: Callable


@reading_once()
def train(
    problem: Problem,
    progress: Progress,
    training: Training,
    engine: Engine,
    callbacks: Sequence[Callback] = (),
    until: int | None = None,
    fresh: Callable[[int], Policy] | None = None,
    bar: ProgressLine = ProgressLine(None),
) -> Progress:
    """Runs the loop from `progress` to its end, and calls the callbacks after every validation.

    With `until` it stops after that step and its validation, and can be continued from there. A
    training whose policy does nothing restarts, the n-th time from `fresh(n)` (n from 0), if
    available. `bar` shows every step.

    It stops early if a callback returns True. On Ctrl-C the callbacks are called once more, and
    `Interrupted`, a `KeyboardInterrupt`, has the progress so far. The status of the result is
    "trained", "stopped early" or "diverged".
    """
    plan = resolve_auto(training, remembering(problem, progress.policy), progress.policy)
    last = plan.steps if until is None else min(until, plan.steps)
    loop = _loop(problem, plan, progress, engine)
    before = progress.history[-1].seconds if progress.history else 0.0
    started = time.perf_counter() - before
    try:
        if progress.step == 0:
            # What training starts from may be hard to beat: it is the first candidate.
            progress = _validate(loop, progress)
        while progress.status == "training" and (until is None or progress.step < last):
            # An interrupt must not leave a step whose validation is due and not done.
            moved = _advance(loop, progress) if progress.step < plan.steps else progress
            if moved.slowed != progress.slowed:
                loop = TrainingLoop(*loop[:5], *_updaters(plan, moved))
            due = _due(moved, plan) or moved.step == last
            if due:
                moved = _conclude(loop, _validate(loop, moved), time.perf_counter() - started)
            if due and fresh is not None and caught(moved, plan):
                moved = begin_again(loop.problem, plan, moved, fresh(len(moved.redrawn)))
                loop = _loop(problem, plan, moved, engine)
            progress = moved
            bar.step(progress.step, plan.steps, progress.best_value)
            if due and callbacks:
                bar.tell("")  # they may print
            # Each is called, also after one that stops the training.
            if due and any([callback(progress) is True for callback in callbacks]):
                progress = stopped(progress)
    except KeyboardInterrupt:
        raise Interrupted(progress, last_calls(callbacks, progress)) from None
    return progress


def _loop(problem: Problem, plan: TrainingPlan, progress: Progress, engine: Engine) -> TrainingLoop:
    """The loop of a training in its present state. A training that stalled draws a part of its
    decisions."""
    local = remembering(problem, progress.policy)
    perturbed = perturbed_problem(
        problem, exploring(plan, problem.action) if progress.redrawn else plan
    )
    observed = local if perturbed is problem else remembering(perturbed, progress.policy)
    bound = engine.bind(observed, controls=False, simplest=False)
    exact = bound if observed is local else engine.bind(local, controls=False, simplest=False)
    return TrainingLoop(observed, plan, bound, local, exact, *_updaters(plan, progress))


def _updaters(training: TrainingPlan, progress: Progress) -> tuple[Callable, Callable]:
    """The compiled updates at the present rate."""
    training = replace(training, learning_rate=progress.rate(training))
    scale = progress.scale
    return updater(training, scale=scale), updater(training, UPDATES, scale)


def _due(progress: Progress, training: TrainingPlan) -> bool:
    """Whether it is time to validate: every so often, and at the end."""
    over = progress.step >= training.steps or progress.status != "training"
    return over or progress.step % training.validation_every == 0


def _advance(loop: TrainingLoop, progress: Progress) -> Progress:
    """One step: fresh paths, one adjoint pass, one update."""
    step, training, problem = progress.step, loop.training, loop.problem
    draws = problem.sources.training.batch(step, training.paths, problem.simulator)
    temperature = training.temperature(step)
    smooth = Smooth(np.float32(temperature))
    dual = _dual(loop, progress, smooth)
    loop = loop._replace(problem=problem.priced(dual.prices))
    progress = _chosen(loop, progress, smooth)
    if progress.window is None:
        moved, value, invalid = _climbed(loop, progress, draws, smooth)
    else:
        moved, value, invalid = _climbed_by_windows(loop, progress, draws, smooth, progress.window)
    lost = invalid + sum(record.bad_paths for record in progress.history[progress.restarted :])
    last = progress.history[-1] if progress.history else None
    exact, best, seconds = (last.exact, last.best, last.seconds) if last else (math.nan,) * 3
    back = {"window": progress.window or 0, "clip": progress.clip or 0.0, "keep": progress.keep}
    record = Record(step + 1, value, moved.norm, temperature, invalid, exact, best, seconds, **back)
    broken = invalid > DIVERGED_SHARE * training.paths or lost > most_dropped(training)
    if broken or not np.isfinite(moved.norm):
        # The policy is that of the step before; the step that broke is written down.
        ended = replace(progress, history=(*progress.history, record), status="diverged")
        slower = may_be_slower(training, progress)
        return go_slower(problem, training, ended) if slower else ended
    selected = (progress.recent, moved.average) if marks(step + 1, training.steps) else ()
    halfway, recent = selected or (progress.halfway, progress.recent)
    return replace(
        progress,
        step=step + 1,
        policy=moved.policy,
        average=moved.average,
        halfway=halfway,
        recent=recent,
        optimiser=moved.optimiser,
        history=(*progress.history, record),
        critic=moved.critic,
        dual=dual,
        status="training",
    )


def _dual(loop: TrainingLoop, progress: Progress, smooth: Smooth) -> Dual:
    """The prices of the limits for this step, from its exact paths."""
    problem, training, dual = loop.inner, loop.training, progress.dual
    if not problem.constraints:
        return dual
    draws = problem.sources.training.batch(progress.step, training.paths, problem.simulator)
    if dual.due(progress.step):
        within = (problem.objective, problem.constraints)
        dual = dual.measured(loop.exact, progress.policy, draws, smooth, *within)
    totals = float64(loop.exact.values(progress.policy, draws, Exact()).totals)
    left = min(1.0, 4 * (1 - progress.step / max(1, training.steps)))  # in the last quarter
    return moved_prices(dual, problem.objective, problem.constraints, totals, left)


class StepResult(NamedTuple):
    """The part of the progress that a step changes, and the norm of its gradient."""

    policy: Policy
    average: Policy
    optimiser: PyTree
    norm: float = math.nan
    critic: Learner | None = None


def _climbed(
    loop: TrainingLoop, progress: Progress, draws, smooth
) -> tuple[StepResult, float, int]:
    """One update over the whole horizon; its objective, and the number of bad paths."""
    policy, objective = progress.policy, loop.problem.objective
    options = _options(progress)
    adjoint = adjoint_of_finite_paths(
        loop.bound_engine, policy, draws, smooth, objective, **options
    )
    value, result, invalid = adjoint
    number = np.float32(progress.step)
    *moved, norm = loop.update(policy, progress.average, progress.optimiser, result.policy, number)
    return StepResult(*moved, norm=float(norm)), value, invalid


def _climbed_by_windows(
    loop: TrainingLoop, progress: Progress, draws, smooth, length: int
) -> tuple[StepResult, float, int]:
    """Updates on several windows of one sweep, whose objective is that of the whole horizon."""
    assert progress.critic is not None
    problem, step, invalid = loop.problem, progress.step, 0
    moved = StepResult(progress.policy, progress.average, progress.optimiser)
    swept = sweep(
        problem, loop.bound_engine, progress.critic, moved.policy, draws, smooth, length, step
    )
    for number in range(UPDATES):
        turn = UPDATES * step + number
        window = (problem, loop.bound_engine, swept, moved.policy, draws, smooth, length, turn)
        _, result, lost = window_adjoint(*window, **_options(progress))
        *after, norm = loop.update_by_windows(*moved[:3], result.policy, np.float32(step))
        moved, invalid = (
            StepResult(*after, norm=float(norm), critic=swept.critic),
            max(invalid, lost),
        )
    return moved, swept.objective, invalid


def _options(progress: Progress) -> dict:
    """How a step of training differentiates."""
    norm = math.inf if progress.clip is None else progress.clip
    clipped = math.isfinite(norm) or progress.keep < 1
    return {"wrt": ("policy",)} | ({"clip": Clip(norm, progress.keep)} if clipped else {})


def most_dropped(training: TrainingPlan) -> float:
    """The number of non-finite paths that a complete run may leave out before it counts as
    diverged."""
    return DROPPED * training.steps * training.paths


def _chosen(loop: TrainingLoop, progress: Progress, smooth: Smooth) -> Progress:
    """With the window and the bound of this step: none until gradients jump or explode."""
    if progress.window is not None or not progress.history:
        return progress
    norms = np.array([record.gradient_norm for record in progress.history])
    training, step, since = loop.training, progress.step, progress.since
    auto = training.clip == "auto"
    # The dual variable of a limit may lead to a bound of the decisions, where gradients are tiny.
    first = training.steps if progress.dual.prices else EARLY
    fell, leapt = has_fallen(norms, since, first), has_leapt(norms, since)
    held_down = is_held_down(norms, since, memory(progress.scale))
    wild = step == FIRST and is_chaotic(_unbounded(progress), training.paths)
    may_window = _may_window(loop, progress, norms, fell or leapt, wild)
    if may_window or (wild and (auto or training.keep == "auto")):
        # Of the best rule so far, mostly the one that training began with: the last steps may have
        # led to a rule whose paths are tame, or wilder than those of any good one.
        measured = sampled_norms(loop.problem, progress.best, smooth, step)
        progress = replace(progress, growth=Growth.of(measured, step))
        if may_window and (length := window_length(measured.total)):
            return _windowed(loop, progress, length)
        # Near an optimum gradients leap up and down as well, and a clip would bend them.
        wild = wild and grows(measured.total)
        # Nor is `keep` lowered where training leaves the wild region by itself.
        if wild and training.keep == "auto" and not fell_for_good(norms):
            progress = replace(progress, keep=share_kept(measured.total))
    if auto and (leapt or wild or (progress.clip is not None and due(step))):
        progress = _clipped(loop, progress, smooth)
    if not auto or not (fell or leapt or wild or held_down):
        return progress
    # Adam's memory of gradients that were far larger would hold its steps down.
    fresh = restarted(training, progress.policy, progress.optimiser, 1)
    return replace(progress, optimiser=fresh, since=step)


def _unbounded(progress: Progress) -> list[float]:
    """The norms of gradients without a bound, which would hide chaos after an early leap."""
    norms = [record.gradient_norm for record in progress.history if not record.clip]
    return norms[progress.since if progress.clip is None else 0 :]


def _may_window(
    loop: TrainingLoop, progress: Progress, norms: np.ndarray, apart: bool, wild: bool
) -> bool:
    """Whether gradients of these norms, of which the last may be far apart, may be chaos."""
    if loop.training.window != "auto" or progress.dual.prices:
        return False
    # Where the whole horizon has taught something, a leap is no reason to leave it.
    gained = progress.stale < progress.step // loop.training.validation_every
    doubtful = wild or (apart and not gained and progress.step > FIRST)
    # If gradients fell permanently, windows would leave a plant that is unstable.
    return doubtful and has_worth_ahead(loop.problem) and not fell_for_good(norms)


def _clipped(loop: TrainingLoop, progress: Progress, smooth: Smooth) -> Progress:
    """The state with a bound from the present adjoints, or without one if they no longer grow."""
    step = progress.step
    if progress.growth is None or progress.clip is not None:
        measured = sampled_norms(loop.problem, progress.policy, smooth, step)
        if progress.growth is None:
            progress = replace(progress, growth=Growth.of(measured, step))
        elif not grows(measured.total):
            return replace(progress, clip=None)
    norms = short_memory_norms(loop.problem, progress.policy, smooth, step)
    return replace(progress, clip=clip_level(norms) or progress.clip)


def _windowed(loop: TrainingLoop, progress: Progress, length: int) -> Progress:
    """The state that continues on windows of this length, with an untrained critic."""
    training = loop.training
    fresh = restarted(training, progress.policy, progress.optimiser, UPDATES)
    if progress.step <= FIRST:
        # Chaos dominated the first steps: training returns to the average of the first few of them,
        # and raises the rate slowly again. At the full rate an unfitted critic ends where no action
        # matters: one Pendulum of seven ended at -766.
        early = progress.halfway
        progress = replace(progress, policy=early, average=early, recent=early)
        fresh = initial_state(training, early, UPDATES)
    return replace(
        progress,
        window=length,
        critic=learner(loop.problem, training.seed),
        clip=None if training.clip == "auto" else progress.clip,
        optimiser=fresh,
        since=progress.step,
    )


def _validate(loop: TrainingLoop, progress: Progress) -> Progress:
    """Measures the averaged policy on the exact simulator, and keeps it if it is the best."""
    problem, source = loop.inner, loop.inner.sources.validation
    paths = np.arange(source.available(loop.training.validation_paths))
    draws = source.draws(paths, problem.simulator)
    totals = loop.exact.values(progress.average, draws, Exact()).totals
    totals = float64(totals)
    value = value_of(problem.objective, totals)
    # Within limits the newest is the best: an earlier one may have more, and not meet them.
    better = np.isfinite(value) and (value > progress.best_value or bool(problem.constraints))
    best = progress.average if better else progress.best
    best_value = value if better else progress.best_value
    history = progress.history
    if history:
        error = estimate(problem.objective, totals, source).standard_error
        available = {"exact": value, "best": best_value, "exact_error": error}
        history = (*history[:-1], history[-1]._replace(**available))
    stale = 0 if better else progress.stale + 1
    same = progress.unchanged + 1 if equal_on_all_paths(problem, totals) else 0
    table = {"best": best, "best_value": best_value, "stale": stale, "unchanged": same}
    return replace(progress, history=history, **table)


def _conclude(loop: TrainingLoop, progress: Progress, seconds: float) -> Progress:
    """The clock of the last record, and whether the run is over."""
    status, training = progress.status, loop.training
    if status == "training" and progress.step >= training.steps:
        status = "trained"
    elif status == "training" and training.patience and progress.stale >= training.patience:
        status = "stopped early"
    history = progress.history
    if history:
        history = (*history[:-1], history[-1]._replace(seconds=seconds))
    return replace(progress, status=status, history=history)
