"""The result of `snapo.learn`: the policy, its value in the model and in the real environment."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from snapo.problem.policy import MLP
from snapo.solver import statistics

if TYPE_CHECKING:
    from ..environments import Played


class Compared(NamedTuple):
    """Episodes of one policy from the same initial observations, in the environment and in the
    model.

    - `real`, `model`: the mean sum of rewards of an episode, with standard errors.
    - `gap`: real minus model, paired by episode, with the error of the difference.
    """

    real: float
    real_error: float
    model: float
    model_error: float
    gap: float
    gap_error: float
    rewards: np.ndarray

    @property
    def episodes(self) -> int:
        """The number of episodes; `rewards` [episodes]: the sum of rewards of each episode in the
        environment."""
        return len(self.rewards)

    @staticmethod
    def of(real: Sequence[float] | np.ndarray, model: np.ndarray) -> "Compared":
        """The comparison, from the sums of rewards of every episode."""
        both = np.asarray(real, np.float64), np.asarray(model, np.float64)
        averages = [statistics.mean(item) for item in (*both, both[0] - both[1])]
        (a, da, _), (b, db, _), (c, dc, _) = averages
        return Compared(a, da, b, db, c, dc, both[0])


class LearningRound(NamedTuple):
    """One round: a fit, a training, and episodes of the new policy in the real environment.

    - `steps`: number of real steps up to the end of the round; `rows`: number of transitions to
      which the model was fitted.
    - `error`: the error of the model on held-out rows, divided by the standard deviation of each
      number (see `Fit.error`).
    - `comparison`: the new policy without noise, from initial observations that all rounds share.
    - `seconds`: processor time in seconds.
    """

    steps: int
    rows: int
    error: np.ndarray
    comparison: Compared
    seconds: float


@dataclass(frozen=True, eq=False)
class Learned:
    """A policy learned in a model, and its results in the real environment.

    - `policy`: maps the environment's observation to its action, both in its units. It can be
      played with `snapo.gym.Agent(policy)`, and saved and exported like every policy.
    - `comparison`: its value in the environment and in the model, and the gap, on fresh initial
      states that no round used.
    - `steps`: total number of steps in the real environment; `hold`: the number of steps for which
      a decision is held.
    - `rounds`: the history; `selected`: the round of this policy, counted from 1. It is the round
      with the highest reward in the real environment from the common initial observations.
    - `model`, `inputs`: the simulator and its inputs after the last fit: `snapo.Problem(model,
      inputs, "reward")`.
    """

    policy: MLP
    comparison: Compared
    steps: int
    hold: int
    limit: int
    rounds: tuple[LearningRound, ...]
    selected: int
    seconds: float
    seed: int
    model: Any
    inputs: Any
    environment: Any

    @property
    def value(self) -> float:
        """The mean sum of rewards of an episode in the real environment."""
        return self.comparison.real

    @property
    def standard_error(self) -> float:
        """The standard error of `value`."""
        return self.comparison.real_error

    @property
    def model_value(self) -> float:
        """The mean sum of rewards in the model, from the same initial observations."""
        return self.comparison.model

    @property
    def gap(self) -> float:
        """The value in the real environment minus the value in the model."""
        return self.comparison.gap

    def play(self, starts: int | Sequence[int] = 100) -> "Played":
        """Further episodes of the policy in the real environment, not counted in `steps`.

        **Raises:** `ValueError` if the environment was an object: pass a name or a function.
        """
        # Late: the public names are there without Gymnasium.
        from ..environments import play
        from ..spaces import gymnasium
        from .real import HeldAction, opened

        if isinstance(self.environment, gymnasium.Env):
            raise ValueError(
                "play: episodes run in parallel, but there is only one environment; pass "
                "its name, or a function that creates it, to learn."
            )

        def held():
            return HeldAction(opened(self.environment), self.hold, self.limit)

        return play(self.policy, held, starts)

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """The result as text; the real values of the rounds are from the starts that all rounds
        have played."""
        result = self.comparison
        titles = ("round", "steps", "fitted to", "worst error", "real", "gap")
        lines = [
            f"real environment {_pair(result.real, result.real_error, result.episodes)}, "
            f"model {_pair(result.model, result.model_error, result.episodes)}, "
            f"gap {_pair(result.gap, result.gap_error, result.episodes)} (95 %) "
            f"over {result.episodes} episodes",
            f"{self.steps:,} real steps, {self.seconds:.0f} s of processor time, "
            f"policy of round {self.selected} of {len(self.rounds)}",
            "{:>5} {:>7} {:>9} {:>11} {:>18} {:>18}".format(*titles),
        ]
        shared = min(entry.comparison.episodes for entry in self.rounds)
        for number, item in enumerate(self.rounds, 1):
            real, error, _ = statistics.mean(item.comparison.rewards[:shared])
            compared = item.comparison
            gap = _pair(compared.gap, compared.gap_error, compared.episodes)
            lines.append(
                f"{number:>5} {item.steps:>7,} {item.rows:>9,} {np.max(item.error[:-1]):>11.2%} "
                f"{_pair(real, error, shared):>18} {gap:>18}"
            )
        return "\n".join(lines)


def _pair(value: float, error: float, episodes: int) -> str:
    return f"{value:.4g} {statistics.plus_minus(error, degrees=episodes - 1)}"
