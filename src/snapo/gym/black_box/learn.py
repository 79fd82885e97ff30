"""The verb `snapo.learn`: a policy for an environment that cannot be differentiated.

Explore; then, round by round: fit a smooth ensemble to all transitions, train the policy through
it by adjoint, and play it in the real environment. Where the model is wrong it is found out there,
and the next fit knows better.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from snapo.engine import Choice
from snapo.problem.policy import MLP
from snapo.solver.train import Training

from .ensemble import first_layers
from .explore import random_actions
from .known import Known
from .learned import Learned, Round
from .model import Over, Reward
from .real import Real
from .rounds import EXPLORE, Plan, begun, compared, fitted, improved, until

LONGEST = 125  # decisions of a path in training, where nobody gives them
FEWEST = 8  # episodes that the steps must suffice for


def learn(
    environment: Any,
    steps: int = 20_000,
    *,
    policy: MLP | None = None,
    rounds: int = 6,
    hold: int | None = None,
    limit: int | None = None,
    horizon: int | None = None,
    members: int = 3,
    hidden: tuple[int, ...] = (64, 64),
    training: Training | None = None,
    reward: Reward | None = None,
    over: Over | None = None,
    seed: int = 0,
    engine: Choice = "auto",
    progress: Callable[[Round], object] | None = None,
) -> Learned:
    """Learns a policy for a black box: a Gymnasium environment with boxes of numbers.

    **Arguments:**

    - `environment`: a name such as "Pendulum-v1", a function that makes the environment, or one.
    - `steps`: the most that the real environment makes, for all purposes together.
    - `policy`: the network's recipe, such as `MLP(hidden=(64, 64))`, or one to train on, such as
      that of an earlier result.
    - `rounds`: of fit, training and real episodes.
    - `hold`: steps of the environment that a decision is held for; by default so many that an
      episode has at most 250 decisions. `limit`: the longest episode, in steps; by default the
      environment's own.
    - `horizon`: decisions of a path in training; by default half an episode, at most 125.
    - `members`, `hidden`: networks of the ensemble, and their layers.
    - `training`: of the policy in the first and the last round; others take half its steps.
    - `reward`: `reward(observation, action, after)` in `jax.numpy`, where it is known; else it is
      learnt. `over`: `over(after)`, a number of order one that is above 0 where the episode ends;
      else the end is learnt.
    - `progress`: told every `Round`.

    **Raises:** `ValueError` where observations or actions are not boxes of numbers, where nothing
    limits an episode, or where the steps do not suffice for eight episodes.
    """
    clock = time.process_time()
    real = Real(environment, hold, limit)
    if rounds < 1 or steps < FEWEST * real.limit:
        raise ValueError(
            f"learn: an episode takes up to {real.limit} steps; got steps={steps} and "
            f"rounds={rounds}, allowed are at least {FEWEST * real.limit} steps and one round."
        )
    horizon = horizon or min(LONGEST, max(1, real.decisions // 2))
    plan = Plan(
        steps, rounds, horizon, members, tuple(hidden), training or _training(seed), reward, over,
        seed, engine,
    )  # fmt: skip
    known = Known.of(real, seed)
    while not known.episodes or known.room(EXPLORE * steps):
        known.play(random_actions(real, known.rng))
    known = known.settled()
    common = known.rng.integers(2**31, size=steps)  # seeds of starts that all rounds share
    size, inside = len(known.units.shift), None
    raw = first_layers(size + real.size, size + 3, plan.hidden, members, seed)
    history: list[Round] = []
    policies: list[MLP] = []
    for number in range(rounds):
        since = time.process_time()
        inside = fitted(plan, known, raw, number)
        raw = inside.fit.raw
        before = policies[-1] if policies else begun(inside, policy, known.units, seed)
        policies.append(improved(plan, inside, before, number))
        found = compared(plan, known, inside, policies[-1], until(plan, number), common)
        spent = time.process_time() - since
        history.append(Round(real.steps, inside.rows, inside.fit.error, found, spent))
        if progress is not None:
            progress(history[-1])
    assert inside is not None
    chosen = _best(history)
    final = compared(plan, known, inside, policies[chosen], steps)
    return Learned(
        policy=known.units.undone(policies[chosen]), found=final, steps=real.steps,
        hold=real.hold, limit=real.limit, rounds=tuple(history), chosen=chosen + 1,
        seconds=time.process_time() - clock, seed=seed, model=inside.model, inputs=inside.inputs,
        environment=environment,
    )  # fmt: skip


def _training(seed: int) -> Training:
    return Training(
        steps=150, paths=128, learning_rate=0.02, window=25, seed=seed, validation_paths=256,
        validation_every=25,
    )  # fmt: skip


def _best(history: list[Round]) -> int:
    """The round whose policy earned most on those starts that all rounds have played."""
    shared = min(each.found.episodes for each in history)
    return int(np.argmax([np.mean(each.found.rewards[:shared]) for each in history]))
