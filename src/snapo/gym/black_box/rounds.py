"""The loop of `snapo.learn`: exploration, the rounds, and episodes of the final policy.

A round fits the model, improves the policy inside it, and plays it in the real environment. Random
actions are held for several decisions, because white noise averages out in a system with momentum:
a mountain car with white noise never leaves its valley. (Eberhard and others 2023, "Pink noise is
all you need", measure how much correlation in time matters.)
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, PyTree

from snapo.engine import EngineName, choose
from snapo.problem.actions import Box
from snapo.problem.objective import Mean
from snapo.problem.policy import MLP
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.smooth import Exact
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.train import Training, initial_progress, train

from ..agent import Agent
from .ensemble import Fit, first_layers, fit
from .learned import Compared, Learned, LearningRound
from .model import Model, Over, Reward
from .real import Act, Episode, Known, Real, Units

SHORTEST, LONGEST = 0.01, 0.1  # for how much of an episode an action is held, log-uniformly
NOISE = 0.3  # of half the range of an action, added to those of a policy


def random_actions(real: Real, rng: np.random.Generator) -> Act:
    """Random actions, often at the limits; every action is held for a time that is drawn for the
    episode."""
    low, high = (np.ravel(item) for item in (real.actions.low, real.actions.high))
    drawn = _held(real, rng)

    def act(observed, number):
        return low + (high - low) * (np.clip(drawn(number), -1, 1) + 1) / 2

    return act


def noisy(policy: Callable[[np.ndarray], np.ndarray], real: Real, rng: np.random.Generator) -> Act:
    """The policy's actions plus held noise, clipped to the bounds."""
    low, high = (np.ravel(item) for item in (real.actions.low, real.actions.high))
    drawn, size = _held(real, rng), NOISE * (high - low) / 2

    def act(observed, number):
        return np.clip(policy(observed) + size * drawn(number), low, high)

    return act


def _held(real: Real, rng: np.random.Generator) -> Callable[[int], np.ndarray]:
    """Uniform numbers from -2 to 2 [m], drawn again after a number of decisions."""
    shortest, longest = (max(1.0, share * real.decisions) for share in (SHORTEST, LONGEST))
    while_ = max(1, round(float(np.exp(rng.uniform(np.log(shortest), np.log(longest))))))
    now = np.zeros(real.size)

    def drawn(number: int) -> np.ndarray:
        nonlocal now
        if number % while_ == 0:
            now = rng.uniform(-2, 2, real.size)
        return now

    return drawn


STARTS = 512  # initial states of the model: half of them those of episodes, half seen on the way
PATHS = 32  # first observations that are valued together
BEYOND = 0.05  # of the observed range: how far the model goes


def inputs_of(fit: Fit, available: Known) -> dict[str, PyTree]:
    """The model's numbers: weights, scales, the range in which it stays, and initial states."""
    observed, firsts, units, rng = (
        available.transitions,
        available.firsts,
        available.units,
        available.rng,
    )
    half = STARTS // 2
    started = firsts[rng.integers(0, len(firsts), half)]
    visited = observed.before[rng.integers(0, observed.count, STARTS - half)]
    every = np.concatenate([observed.before, observed.after]).astype(np.float64)
    low, high = every.min(0), every.max(0)
    room = BEYOND * np.maximum(high - low, units.scale)
    # Slightly beyond the environment's bounds, so that there the smooth corner is not felt.
    slack = 1e-6 * units.scale
    return {
        "layers": fit.layers,
        "spread": fit.spread,
        "shift": units.shift,
        "scale": units.scale,
        "low": np.maximum(low - room, available.real.low - slack),
        "high": np.minimum(high + room, available.real.high + slack),
        "starts": np.concatenate([started, visited]).astype(np.float64),
    }


def trained(
    model: Model,
    inputs: Any,
    policy: MLP,
    training: Training,
    engine: EngineName,
    share: float = 1.0,
) -> MLP:
    """The policy after further training in the model, for a share of the steps."""
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
    """[n] the value in the model from each first observation, as the mean over all members."""
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


EXPLORE, CONFIRM = 0.15, 0.1  # shares of the steps: random ones at first; only the last policy
FIRST, LATER = 4000, 2000  # steps of a fit, at most


@dataclass(frozen=True)
class LearningPlan:
    """The settings of `learn`."""

    steps: int
    rounds: int
    horizon: int
    members: int
    hidden: tuple[int, ...]
    training: Training
    reward: Reward | None
    over: Over | None
    seed: int
    engine: EngineName


class Inside(NamedTuple):
    """The model of a round: the simulator, its inputs, the fit, and the number of rows used."""

    model: Model
    inputs: Any
    fit: Fit
    rows: int


def fewest(rounds: int) -> int:
    """The number of complete episodes that the steps must allow: one in each round, and one of the
    final policy."""
    return max(math.ceil(1 / CONFIRM), math.ceil((rounds + 1) / (1 - EXPLORE)))


def until(plan: LearningPlan, number: int) -> float:
    """The number of real steps at the end of a round: the share of random steps, plus an equal part
    for each round."""
    share = EXPLORE + (1 - CONFIRM - EXPLORE) * (number + 1) / plan.rounds
    return share * plan.steps


def fitted_model(plan: LearningPlan, available: Known, raw: Any, number: int) -> Inside:
    """The model fitted to all transitions; `raw`: the initial weights of the fit."""
    observed, real = available.transitions, available.real
    capacity = -(-plan.steps // real.hold) + real.limit
    result = fit(observed, raw, capacity, LATER if number else FIRST, plan.seed)
    box = Box(np.ravel(real.actions.low), np.ravel(real.actions.high), real.size)
    size, can_end = observed.before.shape[1], bool(observed.ended.any())
    model = Model(
        horizon=plan.horizon,
        action=box,
        noise_size=size,
        members=plan.members,
        can_end=can_end,
        circles=available.circles,
        reward=plan.reward,
        over=plan.over,
    )
    return Inside(model, inputs_of(result, available), result, observed.count)


def initial_policy(inside: Inside, policy: MLP | None, units: Units, seed: int) -> MLP:
    """The policy before any training; a policy that already has weights is converted from the
    environment's units."""
    interface = Problem(inside.model, inside.inputs, Mean("reward")).interface
    made = (policy or MLP(hidden=(32, 32))).for_problem(interface, jax.random.key(seed))
    return made if policy is None or policy.network is None else units.done(made)


def improved(plan: LearningPlan, inside: Inside, policy: MLP, number: int) -> MLP:
    """The policy after further training, on paths that no earlier round used."""
    problem = Problem(inside.model, inside.inputs, Mean("reward"))
    settings, middle = resolve_auto(plan.training, problem, policy), 0 < number < plan.rounds - 1
    settings = replace(settings, seed=settings.seed + 1000 * number)
    if inside.model.may_end:
        # The critic of a window sees no difference between a path that has ended and another.
        settings = replace(settings, window=None)
    share = 0.5 if middle else 1.0
    return trained(inside.model, inside.inputs, policy, settings, plan.engine, share)


def compared(
    plan: LearningPlan,
    available: Known,
    inside: Inside,
    policy: MLP,
    maximum: float,
    common: Any = None,
) -> Compared:
    """Plays as many episodes in the real environment as fit into `maximum` steps, but at least
    one, and the same episodes in the model. With the seeds `common`, every second episode has
    another seed and noise on its actions, and is used for the next fit only.
    """
    agent = Agent(available.units.undone(policy))
    played: list[Episode] = []
    while not played or available.room(maximum):
        seed = None if common is None else int(common[len(played)])
        played.append(available.play(lambda observed, number: agent(observed), seed))
        if common is not None and available.room(maximum):
            available.play(noisy(agent, available.real, available.rng))
    firsts = np.stack([item.start for item in played])
    full_length = replace(inside.model, horizon=available.real.decisions)
    model = value(full_length, inside.inputs, policy, firsts, plan.engine, plan.seed)
    return Compared.of([entry.total for entry in played], model)


def run(
    environment: Any,
    real: Real,
    plan: LearningPlan,
    policy: MLP | None,
    progress: Callable[[LearningRound], object] | None,
) -> Learned:
    """The complete loop; the arguments are those of `learn`."""
    timer = time.process_time()
    available = _explored(real, plan)
    history, policies, inside = _rounds(available, plan, policy, progress)
    selected = _best(history)
    result = compared(plan, available, inside, policies[selected], plan.steps)
    if environment is not real.inner:
        real.inner.close()
    return Learned(
        policy=available.units.undone(policies[selected]), comparison=result, steps=real.steps,
        hold=real.hold, limit=real.limit, rounds=tuple(history), selected=selected + 1,
        seconds=time.process_time() - timer, seed=plan.seed, model=inside.model,
        inputs=inside.inputs, environment=environment,
    )  # fmt: skip


def _explored(real: Real, plan: LearningPlan) -> Known:
    """Plays episodes of random actions, and estimates the units of all numbers from them."""
    available = Known.of(real, plan.seed)
    while not available.episodes or available.room(EXPLORE * plan.steps):
        available.play(random_actions(real, available.rng))
    return available.settled()


def _rounds(
    available: Known,
    plan: LearningPlan,
    policy: MLP | None,
    progress: Callable[[LearningRound], object] | None,
) -> tuple[list[LearningRound], list[MLP], Inside]:
    """Runs all rounds; returns the history, the policy of every round, and the last model."""
    common = available.rng.integers(2**31, size=plan.steps)  # seeds of starts that all rounds share
    size, history, policies, inside = len(available.units.shift), [], [], None
    raw = first_layers(size + available.real.size, size + 3, plan.hidden, plan.members, plan.seed)
    for number in range(plan.rounds):
        since = time.process_time()
        inside = fitted_model(plan, available, raw, number)
        raw = inside.fit.raw
        before = (
            policies[-1] if policies else initial_policy(inside, policy, available.units, plan.seed)
        )
        policies.append(improved(plan, inside, before, number))
        result = compared(plan, available, inside, policies[-1], until(plan, number), common)
        spent = time.process_time() - since
        history.append(
            LearningRound(available.real.steps, inside.rows, inside.fit.error, result, spent)
        )
        if progress is not None:
            progress(history[-1])
    assert inside is not None
    return history, policies, inside


def _best(history: list[LearningRound]) -> int:
    """The round whose policy had the highest reward on the starts that all rounds have played."""
    shared = min(item.comparison.episodes for item in history)
    return int(np.argmax([np.mean(entry.comparison.rewards[:shared]) for entry in history]))
