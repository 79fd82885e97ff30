"""Training: stochastic gradient ascent on the smooth simulator, one adjoint pass a step.

`train` is a plain loop. Adam with warm-up and cosine decay climbs; the temperature of the
constraints is annealed; the parameters are averaged; the averaged policy is validated on the
EXACT simulator and the best one is kept. Fresh scenarios every step are a function of seed and
step, so a run that stops goes on bit for bit from its `Progress`.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, PyTree

from snapo.engine import Bound, Clip, Engine, Window
from snapo.problem.policy import Policy, trainable
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact, Smooth

from .adjoint import float64
from .evaluate import worth
from .finite_paths import DROPPED, adjoint_of_finite_paths
from .learning import clipping

DIVERGED_SHARE = 0.05  # more than this share of a step's paths not finite: the run has diverged


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
    - `clip`: bound on each path's own adjoint at every step (see `engine.Clip`); "auto" finds one
      where gradients explode and leaves all others alone (`solver.learning.clipping`); None: never.
    - `seed`: of the network's first weights and of all scenarios.
    """

    steps: int = 240
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
    clip: float | str | None = "auto"
    seed: int = 0

    def __post_init__(self):
        for name, least in COUNTS.items():
            if (value := getattr(self, name)) is not None:
                whole(f"Training: {name}", value, least)
        number = isinstance(self.clip, int | float) and self.clip > 0
        if not number and self.clip not in ("auto", None):
            raise ValueError(
                f"Training: clip is {self.clip!r}; allowed is a number above 0, 'auto' or None."
            )

    def temperature(self, step: int) -> float:
        """Geometric from start to end, which is reached at three quarters of the steps."""
        done = min(1.0, step / max(1.0, 0.75 * self.steps))
        return self.temperature_start * (self.temperature_end / self.temperature_start) ** done


COUNTS = {
    "steps": 0, "paths": 1, "warmup": 0, "validation_paths": 1, "validation_every": 1,
    "patience": 1, "window": 1,
}  # fmt: skip


def whole(name: str, value: object, least: int) -> None:
    """Refuses what is no whole number of at least `least`."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} is {value!r}; allowed is a whole number of at least {least}.")


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
    """Everything that a stopped run needs to go on: the whole state of the loop.

    `halfway` and `recent` are averaged policies of the last two steps of the series …, steps / 4,
    steps / 2, steps: wherever a run stops, the first is from its second quarter, or its middle.
    `clip` is the bound in force, if there is one; `since` the step at which the optimiser began, or
    began anew, its gradients having exploded.
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
    clip: float | None = None
    since: int = 0


Callback = Callable[[Progress], None]


def begin(policy: Policy, training: Training) -> Progress:
    """The state before the first step."""
    moving, _ = trainable(policy)
    state = _optimiser(training).init(_flat(moving))
    nothing = float("-inf")
    given = training.clip if isinstance(training.clip, int | float) else None
    start = Progress(0, policy, policy, policy, policy, policy, state, nothing, 0, (), "training")
    return replace(start, clip=given)


class Loop(NamedTuple):
    """All that one step of training needs; `update` is the compiled step of the optimiser."""

    problem: Problem
    training: Training
    bound: Bound
    update: Callable


def train(
    problem: Problem,
    progress: Progress,
    training: Training,
    engine: Engine,
    callbacks: Sequence[Callback] = (),
) -> Progress:
    """Runs the loop from `progress` to its end, and tells the callbacks after every validation.

    On Ctrl-C the callbacks are told once more, and the interrupt goes on to the caller. The status
    of the result is "trained", "stopped early" or "diverged".
    """
    loop = Loop(problem, training, engine.bind(problem), _updater(training))
    before = progress.history[-1].seconds if progress.history else 0.0
    started = time.perf_counter() - before
    try:
        if progress.step == 0:
            # What training starts from may be hard to beat: it is the first candidate.
            progress = _validate(loop, progress)
        while progress.status == "training":
            # An interrupt must not leave a step whose validation is due and not done.
            moved = _advance(loop, progress) if progress.step < training.steps else progress
            due = _due(moved, training)
            if due:
                moved = _conclude(loop, _validate(loop, moved), time.perf_counter() - started)
            progress = moved
            for callback in callbacks if due else ():
                callback(progress)
    except KeyboardInterrupt:
        for callback in callbacks:
            callback(progress)
        raise
    return progress


def _due(progress: Progress, training: Training) -> bool:
    """Whether it is time to validate: every so often, and at the end."""
    over = progress.step >= training.steps or progress.status != "training"
    return over or progress.step % training.validation_every == 0


def _advance(loop: Loop, progress: Progress) -> Progress:
    """One step: fresh paths, one adjoint pass, one update."""
    step, training, problem = progress.step, loop.training, loop.problem
    draws = problem.sources.training.batch(step, training.paths, problem.simulator)
    temperature = training.temperature(step)
    smooth = Smooth(np.float32(temperature))
    progress = _clipped(loop, progress, smooth)
    options = _options(loop, progress, draws, smooth)
    value, result, bad = adjoint_of_finite_paths(
        loop.bound, progress.policy, draws, smooth, problem.objective, **options
    )
    lost = bad + sum(record.bad_paths for record in progress.history)
    if bad > DIVERGED_SHARE * training.paths or lost > most_dropped(training):
        return replace(progress, status="diverged")
    policy, average, optimiser, norm = loop.update(
        progress.policy, progress.average, progress.optimiser, result.policy, np.float32(step)
    )
    last = progress.history[-1] if progress.history else None
    exact, best, seconds = (last.exact, last.best, last.seconds) if last else (math.nan,) * 3
    record = Record(step + 1, value, float(norm), temperature, bad, exact, best, seconds)
    kept = (progress.recent, average) if _marks(step + 1, training.steps) else ()
    halfway, recent = kept or (progress.halfway, progress.recent)
    return replace(
        progress,
        step=step + 1,
        policy=policy,
        average=average,
        halfway=halfway,
        recent=recent,
        optimiser=optimiser,
        history=(*progress.history, record),
        status="training" if np.isfinite(norm) else "diverged",
    )


def most_dropped(training: Training) -> float:
    """How many paths of a whole run may be not finite, and are left out, before it diverges."""
    return DROPPED * training.steps * training.paths


def _marks(step: int, steps: int) -> bool:
    """Whether a step is one of steps, steps / 2, steps / 4, …, rounded down."""
    return step in (steps >> k for k in range(steps.bit_length()))


def _clipped(loop: Loop, progress: Progress, smooth: Smooth) -> Progress:
    """The bound of this step: none until gradients explode, then measured every few steps."""
    step, norms = progress.step, [record.gradient_norm for record in progress.history]
    if loop.training.clip != "auto" or not norms:
        return progress
    anew = clipping.exploded(norms, progress.since)
    if not anew and (progress.clip is None or step % clipping.EVERY):
        return progress
    clip = clipping.bound(loop.problem, progress.policy, smooth, step) or progress.clip
    progress = replace(progress, clip=clip)
    if not anew:
        return progress
    fresh = _optimiser(loop.training).init(_flat(trainable(progress.policy)[0]))
    forgotten = clipping.forgotten(progress.optimiser, fresh)
    return replace(progress, optimiser=forgotten, since=step)


def _options(loop: Loop, progress: Progress, draws, smooth) -> dict:
    """The clip, and the window of this step with its starting states."""
    training, horizon = loop.training, loop.problem.simulator.horizon
    options: dict = {"wrt": ("policy",)}
    if progress.clip is not None:
        options["clip"] = Clip(progress.clip)
    if training.window is not None and training.window < horizon:
        length = training.window
        firsts = np.arange(0, horizon - length + 1, max(1, length // 2))
        first = int(firsts[progress.step % len(firsts)])
        if first:
            before = loop.bound.values(progress.policy, draws, smooth, window=Window(0, first))
            options["start"] = before.state
        options["window"] = Window(first, length)
    return options


def _validate(loop: Loop, progress: Progress) -> Progress:
    """Measures the averaged policy on the exact simulator, and keeps it if it is the best."""
    problem, source = loop.problem, loop.problem.sources.validation
    paths = np.arange(source.available(loop.training.validation_paths))
    draws = source.draws(paths, problem.simulator)
    totals = loop.bound.values(progress.average, draws, Exact()).totals
    value = worth(problem.objective, float64(totals))
    better = np.isfinite(value) and value > progress.best_value
    best = progress.average if better else progress.best
    best_value = value if better else progress.best_value
    history = progress.history
    if history:
        history = (*history[:-1], history[-1]._replace(exact=value, best=best_value))
    stale = 0 if better else progress.stale + 1
    return replace(progress, best=best, best_value=best_value, stale=stale, history=history)


def _conclude(loop: Loop, progress: Progress, seconds: float) -> Progress:
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

    @jax.jit
    def ascend(moving, old, state, gradient, step):
        change, state = optimiser.update(-gradient, state, moving)
        moving = optax.apply_updates(moving, change)
        # A running mean whose memory grows to `memory` steps: early on it forgets the start.
        share = jnp.maximum(1 / memory, 1 / (1 + step)).astype(old.dtype)
        return moving, old + share * (moving - old), state, jnp.linalg.norm(gradient)

    def update(policy, average, state, gradient, step):
        # What is not trained goes round the compiled part.
        moving, fixed = trainable(policy)
        flat = _flat(moving)
        old, slope = (_flat(trainable(tree)[0]) for tree in (average, gradient))
        flat, old, state, norm = ascend(flat, old, state, slope.astype(flat.dtype), step)
        policy, average = (eqx.combine(_shaped(x, moving), fixed) for x in (flat, old))
        return policy, average, state, norm

    return update


def _flat(tree: PyTree) -> np.ndarray:
    """All numbers of a tree as one vector: one array compiles in half the time of many."""
    leaves = [np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(tree)]
    return np.concatenate([np.zeros(0, np.float32), *leaves])


def _shaped(flat: Array, like: PyTree) -> PyTree:
    """The numbers of a vector in the shapes and types of a tree."""
    leaves, structure = jax.tree.flatten(like)
    parts = np.split(np.asarray(flat), np.cumsum([leaf.size for leaf in leaves])[:-1])
    shaped = [
        part.reshape(leaf.shape).astype(leaf.dtype, copy=False) for part, leaf in zip(parts, leaves)
    ]
    return jax.tree.unflatten(structure, shaped)
