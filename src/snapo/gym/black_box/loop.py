"""The loop of `snapo.learn`: explore, then rounds, then the last policy alone."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from snapo.problem.policy import MLP

from .ensemble import first_layers
from .explore import random_actions
from .known import Known
from .learned import Learned, LearningRound
from .real import Real
from .rounds import (
    EXPLORE,
    Inside,
    LearningPlan,
    compared,
    fitted_model,
    improved,
    initial_policy,
    until,
)


def run(
    environment: Any,
    real: Real,
    plan: LearningPlan,
    policy: MLP | None,
    progress: Callable[[LearningRound], object] | None,
) -> Learned:
    """All of it; the arguments are those of `learn`."""
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
    """Episodes of random actions, and the units that they give."""
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
    """The history, the policy of every round, and the last model."""
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
    """The round whose policy earned most on those starts that all rounds have played."""
    shared = min(item.comparison.episodes for item in history)
    return int(np.argmax([np.mean(entry.comparison.rewards[:shared]) for entry in history]))
