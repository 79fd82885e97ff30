"""`snapo.learn`: a policy for an environment that cannot be differentiated.

After an exploration, every round fits a smooth ensemble to all transitions, trains the policy
through the ensemble by the adjoint method, and plays the policy in the real environment. Errors of
the model appear there, and the next fit corrects them.
"""

from collections.abc import Callable
from typing import Any

from snapo.engine import EngineName
from snapo.problem.policy import MLP
from snapo.solver.train import Training

from .learned import Learned, LearningRound
from .model import Over, Reward

LONGEST = 125  # decisions of a path in training, by default


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
    engine: EngineName = "auto",
    progress: Callable[[LearningRound], object] | None = None,
) -> Learned:
    """Learns a policy for a black box: a Gymnasium environment whose observations and actions are
    boxes of numbers.

    **Arguments:**

    - `environment`: a name such as "Pendulum-v1", a function that creates it, or an environment.
    - `steps`: the maximum number of steps in the real environment, in total.
    - `policy`: the network's recipe, such as `MLP(hidden=(64, 64))`, or a policy to train further,
      such as the policy of an earlier result.
    - `rounds`: the number of rounds of fit, training and real episodes.
    - `hold`: number of steps of the environment for which a decision is held; by default the
      smallest number with at most 250 decisions in an episode. `limit`: the largest number of steps
      in an episode; by default the limit of the environment.
    - `horizon`: number of decisions in a path of training; by default half an episode, at most 125.
    - `members`, `hidden`: number of networks in the ensemble, and the widths of their hidden
      layers.
    - `training`: settings of training in the first and the last round; the other rounds use half
      its steps.
    - `reward`: `reward(observation, action, after)` in `jax.numpy`, if the reward is known; by
      default it is learned. `over`: `over(after)`, a number of order one that is above 0 if the
      episode ends; by default the end is learned.
    - `progress`: called with every `LearningRound`.

    **Raises:** `ValueError` if observations or actions are not boxes of numbers, if episodes have
    no limit, or if the steps are not sufficient for ten episodes (or more, if there are more
    rounds).
    """
    # Late: the public names are there without Gymnasium.
    from .real import Real
    from .rounds import LearningPlan, fewest, run

    real = Real(environment, hold, limit)
    minimum = fewest(rounds) * real.limit
    if rounds < 1 or steps < minimum:
        raise ValueError(
            f"learn: an episode takes up to {real.limit} steps; got steps={steps} and "
            f"rounds={rounds}; use at least one round, and {minimum} steps for these rounds."
        )
    horizon = horizon or min(LONGEST, max(1, real.decisions // 2))
    plan = LearningPlan(
        steps, rounds, horizon, members, tuple(hidden), training or _training(seed), reward, over,
        seed, engine,
    )  # fmt: skip
    return run(environment, real, plan, policy, progress)


def _training(seed: int) -> Training:
    return Training(
        steps=150, paths=128, learning_rate=0.02, window=25, seed=seed, validation_paths=256,
        validation_every=25,
    )  # fmt: skip
