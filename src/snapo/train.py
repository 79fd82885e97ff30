"""Training: stochastic gradient ascent on the smooth simulator, one adjoint pass a step.

`train` is a plain loop. Adam with warm-up and cosine decay climbs; the temperature of the
constraints is annealed; the parameters are averaged; the averaged policy is validated on the
EXACT simulator and the best one is kept. Fresh scenarios every step are a function of seed and
step, so a run that stops goes on bit for bit from its `Progress`.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import PyTree

from .adjoint import flat_weights, float64, weighted_adjoint
from .engine import Adjoint, Clip, Engine, Window
from .objective import Objective
from .policy import Policy, trainable
from .scenarios import Draws, Pseudo
from .simulator import Schedule, Simulator
from .smooth import Exact, Smooth

TRAIN_STREAM, VALIDATE_STREAM, EVALUATE_STREAM = 1, 2, 3
DIVERGED_SHARE = 0.05  # more than this share of paths not finite: the run has diverged


@dataclass(frozen=True)
class Training:
    """How a policy is trained.

    - `steps`, `paths`: updates, and antithetic fresh paths for each.
    - `learning_rate`, `warmup`: Adam's peak rate, reached linearly in `warmup` steps, then cosine
      decay to zero.
    - `temperature_start`, `temperature_end`: of the smooth constraints, annealed geometrically.
    - `average`: the averaged policy remembers about this share of the steps.
    - `validation_paths`, `validation_every`, `patience`: the exact value is measured every so many
      steps; after `patience` validations without a new best the run stops (None: never).
    - `window`: train on windows of this many steps, starting from states of the present policy.
    - `clip`: bound on each path's own adjoint at every step (see `engine.Clip`).
    - `seed`: of the network's first weights and of all scenarios.
    """

    steps: int = 600
    paths: int = 512
    learning_rate: float = 0.01
    warmup: int = 20
    temperature_start: float = 0.02
    temperature_end: float = 0.005
    average: float = 0.05
    validation_paths: int = 4096
    validation_every: int = 50
    patience: int | None = None
    window: int | None = None
    clip: float | None = None
    seed: int = 0

    def temperature(self, step: int) -> float:
        """Geometric from start to end, which is reached at three quarters of the steps."""
        done = min(1.0, step / max(1.0, 0.75 * self.steps))
        return self.temperature_start * (self.temperature_end / self.temperature_start) ** done


class Record(NamedTuple):
    """One line of the training history; `exact` and `best` as of the last validation."""

    step: int
    objective: float
    gradient_norm: float
    temperature: float
    bad_paths: int
    exact: float
    best: float
    seconds: float


@dataclass(frozen=True)
class Progress:
    """Everything that a stopped run needs to go on: the whole state of the loop."""

    step: int
    policy: Policy
    average: Policy
    best: Policy
    halfway: Policy
    optimiser: PyTree
    best_value: float
    stale: int
    history: tuple[Record, ...]
    status: str


Callback = Callable[[Progress], None]


def begin(policy: Policy, training: Training) -> Progress:
    """The state before the first step."""
    moving, _ = trainable(policy)
    state = _optimiser(training).init(moving)
    nothing = float("-inf")
    return Progress(0, policy, policy, policy, policy, state, nothing, 0, (), "training")


def train(
    simulator: Simulator,
    schedule: Schedule,
    progress: Progress,
    objective: Objective,
    training: Training,
    engine: Engine,
    callbacks: Sequence[Callback] = (),
) -> Progress:
    """Runs the loop from `progress` to its end, and tells the callbacks after every validation.

    On Ctrl-C the callbacks are told once more, and the interrupt goes on to the caller. The status
    of the result is "trained", "stopped early" or "diverged".
    """
    update = _updater(training)
    if progress.best_value == float("-inf"):
        progress = _validate(simulator, schedule, progress, objective, training, engine)
    started, before = time.perf_counter(), progress.history[-1].seconds if progress.history else 0.0
    try:
        while progress.status == "training":
            if progress.step < training.steps:
                progress = _advance(
                    simulator, schedule, progress, objective, training, engine, update
                )
            done = progress.step >= training.steps
            if (
                done
                or progress.status != "training"
                or progress.step % training.validation_every == 0
            ):
                progress = _validate(simulator, schedule, progress, objective, training, engine)
                progress = _conclude(progress, training, before + time.perf_counter() - started)
                for callback in callbacks:
                    callback(progress)
    except KeyboardInterrupt:
        for callback in callbacks:
            callback(progress)
        raise
    return progress


def _advance(
    simulator, schedule, progress: Progress, objective, training, engine, update
) -> Progress:
    """One step: fresh paths, one adjoint pass, one update."""
    step = progress.step
    scenarios = Pseudo(training.seed, stream=(TRAIN_STREAM << 32) + step)
    draws = scenarios.draws(np.arange(training.paths), simulator)
    temperature = training.temperature(step)
    smooth = Smooth(np.float32(temperature))
    options = _options(simulator, schedule, progress.policy, draws, smooth, training, engine, step)
    value, result, bad = adjoint_of_finite_paths(
        engine, simulator, progress.policy, schedule, draws, smooth, objective, **options
    )
    if bad > DIVERGED_SHARE * training.paths:
        return replace(progress, status="diverged")
    policy, average, optimiser, norm = update(
        progress.policy, progress.average, progress.optimiser, result.policy, np.float32(step)
    )
    last = progress.history[-1] if progress.history else None
    exact, best, seconds = (last.exact, last.best, last.seconds) if last else (np.nan, np.nan, 0.0)
    record = Record(step + 1, value, float(norm), temperature, bad, exact, best, seconds)
    halfway = average if step + 1 == training.steps // 2 else progress.halfway
    return Progress(
        step + 1,
        policy,
        average,
        progress.best,
        halfway,
        optimiser,
        progress.best_value,
        progress.stale,
        (*progress.history, record),
        "training" if np.isfinite(norm) else "diverged",
    )


def _options(simulator, schedule, policy, draws, smooth, training: Training, engine, step) -> dict:
    """The clip, and the window of this step with its starting states."""
    options: dict = {"wrt": ("policy",)}
    if training.clip is not None:
        options["clip"] = Clip(training.clip)
    if training.window is not None and training.window < simulator.horizon:
        length = training.window
        starts = np.arange(0, simulator.horizon - length + 1, max(1, length // 2))
        first = int(starts[step % len(starts)])
        if first:
            upto = engine.values(
                simulator, policy, schedule, draws, smooth, window=Window(0, first)
            )
            options["start"] = upto.state
        options["window"] = Window(first, length)
    return options


def adjoint_of_finite_paths(
    engine, simulator, policy, schedule, draws: Draws, smooth, objective, **options
) -> tuple[float, Adjoint, int]:
    """`weighted_adjoint` over the paths that are finite, and the number of those that are not.

    Zero weight would not silence a path that is not finite (0 x inf is NaN), so such a path is
    replaced by a copy of a finite one that counts for nothing.
    """
    value, result = weighted_adjoint(
        engine, simulator, policy, schedule, draws, smooth, objective, **options
    )
    if np.isfinite(value) and _all_finite(result.policy):
        return value, result, 0
    good = _finite_paths(engine, simulator, policy, schedule, draws, smooth, objective, options)
    bad = int(np.sum(~good))
    if bad == 0 or bad == good.size:
        return value, result, good.size
    source = np.where(good, np.arange(good.size), np.argmax(good))
    draws, options = _only(source, draws, options)
    window = {key: options[key] for key in ("window", "start") if key in options}
    totals = float64(engine.values(simulator, policy, schedule, draws, smooth, **window).totals)
    kept = {name: total[good] for name, total in totals.items()}
    weights = objective.weights(kept)
    spread = {name: np.zeros(good.size) for name in weights}
    for name, weight in weights.items():
        spread[name][good] = weight
    result = engine.adjoint(simulator, policy, schedule, draws, smooth, spread, **options)
    return objective.value(kept), result, bad


def _finite_paths(
    engine, simulator, policy, schedule, draws, smooth, objective, options
) -> np.ndarray:
    """Which paths have finite totals and a finite adjoint, found by looking at each alone."""
    weights = {name: np.ones(1) for name in objective.outputs}
    good = np.zeros(draws.size, bool)
    for path in range(draws.size):
        alone, given = _only(np.array([path]), draws, options)
        result = engine.adjoint(simulator, policy, schedule, alone, smooth, weights, **given)
        good[path] = _all_finite(result.policy) and _all_finite(result.totals)
    return good


def _only(chosen: np.ndarray, draws: Draws, options: dict) -> tuple[Draws, dict]:
    """The noise and the starting states of chosen paths alone."""
    axes = draws.axes()
    picked = jax.tree.map(
        lambda leaf, axis: leaf if axis is None else np.take(leaf, chosen, axis),
        draws,
        axes,
        is_leaf=lambda leaf: leaf is None,
    )
    start = options.get("start")
    if start is None:
        return picked, options
    return picked, options | {"start": jax.tree.map(lambda leaf: leaf[chosen], start)}


def _all_finite(tree: PyTree) -> bool:
    return all(bool(np.all(np.isfinite(np.asarray(leaf)))) for leaf in jax.tree.leaves(tree))


def validation_value(simulator, schedule, policy, objective, training: Training, engine) -> float:
    """The objective of the exact simulator on the run's validation paths (always the same)."""
    scenarios = Pseudo(training.seed, stream=VALIDATE_STREAM << 32)
    draws = scenarios.draws(np.arange(training.validation_paths), simulator)
    totals = engine.values(simulator, policy, schedule, draws, Exact()).totals
    return objective.value(float64(totals))


def _validate(simulator, schedule, progress: Progress, objective, training, engine) -> Progress:
    value = validation_value(simulator, schedule, progress.average, objective, training, engine)
    better = np.isfinite(value) and value > progress.best_value
    best = progress.average if better else progress.best
    best_value = value if better else progress.best_value
    history = progress.history
    if history:
        history = (*history[:-1], history[-1]._replace(exact=value, best=best_value))
    stale = 0 if better else progress.stale + 1
    return replace(progress, best=best, best_value=best_value, stale=stale, history=history)


def _conclude(progress: Progress, training: Training, seconds: float) -> Progress:
    """The clock of the last record, and whether the run is over."""
    status = progress.status
    if status == "training" and progress.step >= training.steps:
        status = "trained"
    elif status == "training" and training.patience and progress.stale >= training.patience:
        status = "stopped early"
    history = progress.history
    if history:
        history = (*history[:-1], history[-1]._replace(seconds=seconds))
    return replace(progress, status=status, history=history)


def _optimiser(training: Training) -> optax.GradientTransformation:
    # Objectives come in any unit, so Adam's guard against division by zero must be tiny.
    warmup = min(training.warmup, max(0, training.steps - 1))
    rate = optax.warmup_cosine_decay_schedule(
        0.0 if warmup else training.learning_rate,
        training.learning_rate,
        warmup,
        max(1, training.steps),
    )
    return optax.adam(rate, eps=1e-16)


def _updater(training: Training):
    """The compiled update: ascend, and move the average along."""
    optimiser = _optimiser(training)
    memory = max(1.0, training.average * training.steps)

    @eqx.filter_jit
    def update(policy, average, state, gradient, step):
        moving, fixed = trainable(policy)
        gradient, _ = trainable(gradient)
        descent = jax.tree.map(lambda g, p: -g.astype(p.dtype), gradient, moving)
        change, state = optimiser.update(descent, state, moving)
        moving = optax.apply_updates(moving, change)
        # A running mean whose memory grows to `memory` steps: early on it forgets the start.
        share = jnp.maximum(1 / memory, 1 / (1 + step))
        old, _ = trainable(average)
        average = jax.tree.map(lambda a, p: a + share.astype(p.dtype) * (p - a), old, moving)
        policy = eqx.combine(moving, fixed)
        return policy, eqx.combine(average, fixed), state, optax.tree.norm(gradient)

    return update
