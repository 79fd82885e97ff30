"""One round: fit the model, improve the policy inside it, and play it in the real environment."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.engine import EngineName
from snapo.problem.actions import Box
from snapo.problem.objective import Mean
from snapo.problem.policy import MLP
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import resolve_auto as chosen
from snapo.solver.train import Training

from ..agent import Agent
from .ensemble import Fit, fit
from .explore import noisy
from .inside import inputs_of, trained, value
from .known import Known, Units
from .learned import Compared
from .model import Model, Over, Reward
from .real import Episode

EXPLORE, CONFIRM = 0.15, 0.1  # shares of the steps: random ones at first; the last policy alone
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
    """The model of a round: the simulator, its numbers, their fit, and the rows that it saw."""

    model: Model
    inputs: Any
    fit: Fit
    rows: int


def fewest(rounds: int) -> int:
    """The whole episodes that the steps must suffice for: each round plays one, and the last policy
    another, wherever they stand."""
    return max(math.ceil(1 / CONFIRM), math.ceil((rounds + 1) / (1 - EXPLORE)))


def until(plan: LearningPlan, number: int) -> float:
    """The real steps made when a round is over: the share of random ones, then equal parts."""
    share = EXPLORE + (1 - CONFIRM - EXPLORE) * (number + 1) / plan.rounds
    return share * plan.steps


def fitted_model(plan: LearningPlan, available: Known, raw: Any, number: int) -> Inside:
    """The model of all that was seen; `raw` are the weights that the fit goes on from."""
    observed, real = available.transitions, available.real
    capacity = -(-plan.steps // real.hold) + real.limit
    result = fit(observed, raw, capacity, LATER if number else FIRST, plan.seed)
    box = Box(np.ravel(real.actions.low), np.ravel(real.actions.high), real.size)
    size, endpoints = observed.before.shape[1], bool(observed.ended.any())
    model = Model(
        horizon=plan.horizon,
        action=box,
        noise_size=size,
        members=plan.members,
        can_end=endpoints,
        circles=available.circles,
        reward=plan.reward,
        over=plan.over,
    )
    return Inside(model, inputs_of(result, available), result, observed.count)


def initial_policy(inside: Inside, policy: MLP | None, units: Units, seed: int) -> MLP:
    """The policy before any training; one that has weights takes the environment's units."""
    interface = Problem(inside.model, inside.inputs, Mean("reward")).interface
    made = (policy or MLP(hidden=(32, 32))).for_problem(interface, jax.random.key(seed))
    return made if policy is None or policy.network is None else units.done(made)


def improved(plan: LearningPlan, inside: Inside, policy: MLP, number: int) -> MLP:
    """The policy trained on, on paths that no round had before."""
    problem = Problem(inside.model, inside.inputs, Mean("reward"))
    settings, middle = chosen(plan.training, problem, policy), 0 < number < plan.rounds - 1
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
    """Episodes in the real environment up to `maximum` steps in all, one at least, and the same in
    the model.

    With the seeds `common` every second episode is another, with noise, for the next fit alone.
    """
    agent = Agent(available.units.undone(policy))
    played: list[Episode] = []
    while not played or available.room(maximum):
        seed = None if common is None else int(common[len(played)])
        played.append(available.play(lambda observed, number: agent(observed), seed))
        if common is not None and available.room(maximum):
            available.play(noisy(agent, available.real, available.rng))
    firsts = np.stack([item.start for item in played])
    complete = replace(inside.model, horizon=available.real.decisions)
    model = value(complete, inside.inputs, policy, firsts, plan.engine, plan.seed)
    return Compared.of([entry.total for entry in played], model)
