"""Inside the model: its numbers from a fit, the training of a policy, and the policy's value."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, PyTree

from snapo.engine import EngineName, choose
from snapo.problem.objective import Mean
from snapo.problem.policy import MLP
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.smooth import Exact
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.train import Training, initial_progress, train

from .ensemble import Fit
from .known import Known
from .model import Model

STARTS = 512  # first states of the model: half of them those of episodes, half seen on the way
PATHS = 32  # first observations that are valued together
BEYOND = 0.05  # of the range of what was seen: how far the model goes


def inputs_of(fit: Fit, available: Known) -> dict[str, PyTree]:
    """The model's numbers: weights, scales, the range that it stays in, and first states."""
    observed, firsts, units, rng = (
        available.transitions,
        available.firsts,
        available.units,
        available.rng,
    )
    half = STARTS // 2
    started = firsts[rng.integers(0, len(firsts), half)]
    met = observed.before[rng.integers(0, observed.count, STARTS - half)]
    every = np.concatenate([observed.before, observed.after]).astype(np.float64)
    low, high = every.min(0), every.max(0)
    room = BEYOND * np.maximum(high - low, units.scale)
    # A little beyond the environment's own bounds, so that there the smooth corner is not felt.
    slack = 1e-6 * units.scale
    return {
        "layers": fit.layers,
        "spread": fit.spread,
        "shift": units.shift,
        "scale": units.scale,
        "low": np.maximum(low - room, available.real.low - slack),
        "high": np.minimum(high + room, available.real.high + slack),
        "starts": np.concatenate([started, met]).astype(np.float64),
    }


def trained(
    model: Model,
    inputs: Any,
    policy: MLP,
    training: Training,
    engine: EngineName,
    share: float = 1.0,
) -> MLP:
    """The policy trained on in the model, for a share of the steps."""
    sources = Sources.of(None, training.seed)
    problem = Problem(model, inputs, Mean("reward"), sources)
    engines = choose(engine, problem, policy)
    plan = resolve_auto(training, problem, policy)
    plan = replace(plan, steps=max(min(1, plan.steps), int(share * plan.steps)))
    progress = train(problem, initial_progress(policy, plan, problem), plan, engines.train)
    assert isinstance(progress.best, MLP)
    return progress.best


def value(
    model: Model,
    inputs: Any,
    policy: MLP,
    firsts: Float[np.ndarray, "n k"],
    engine: EngineName,
    seed,
) -> np.ndarray:
    """[n] the value in the model from each first observation, the mean over all members."""
    problem = Problem(model, inputs, Mean("reward"))
    bound = choose(engine, problem, policy).train.bind(problem)
    members, count = model.members, len(firsts)
    # So many paths always, so that an engine compiles one number of them.
    rows = np.resize(np.arange(count), max(PATHS, count))
    number = np.repeat(np.arange(members), len(rows))
    paths = len(number)
    start = {
        "seen": np.tile(np.asarray(firsts, np.float32)[rows], (members, 1)),
        "member": np.eye(members, dtype=np.float32)[number],
        "alive": np.ones(paths, np.float32),
    }
    draws = Pseudo(seed).draws(np.arange(paths), model)
    totals = bound.values(policy, draws, Exact(), start=start).totals["reward"]
    return np.asarray(totals, np.float64).reshape(members, -1).mean(0)[:count]
