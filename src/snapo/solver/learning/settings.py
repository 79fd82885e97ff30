"""The settings of a training."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from snapo.problem.actions.base import count


class _Follows(int):
    """A number that is chosen when the problem is known."""

    def __repr__(self) -> str:
        return "FOLLOWS"


class _Rate(float):
    """A rate that is chosen when the problem is known."""


FOLLOWS = _Follows(0)  # where a setting is not given (see `following`)
DECAY = _Rate(0.0)  # of weights, where it is not given; it is this one where the steps are given
EXPLORATION = _Rate(0.0)  # the same, of decisions
RATE = _Rate(0.01)  # of Adam, where it is not given; it is this one where the steps are given


def chosen_rate(value: float) -> float:
    """A rate that `follows` still knows as one that nobody gave."""
    return _Rate(value)


def follows(value: object) -> bool:
    """Whether a setting is not given, so that it follows the problem."""
    return isinstance(value, _Follows | _Rate)


@dataclass(frozen=True)
class Training:
    """How a policy is trained.

    - `steps`, `paths`: updates, and antithetic fresh paths for each; where they are not given, they
      follow the horizon and the size of the policy, and `learning_rate` follows them
      (`solver.learning.following`).
    - `learning_rate`, `warmup`: Adam's peak rate, reached linearly in `warmup` steps, then cosine
      decay to zero.
    - `decay`: the share that a step takes off every trained number, times the rate (AdamW); where
      neither it nor the steps are given, above 0 for more than eight decisions in one step.
    - `temperature_start`, `temperature_end`: of the smooth constraints, annealed geometrically.
    - `average`: the averaged policy remembers about this share of the steps.
    - `validation_paths`, `validation_every`, `patience`: the exact value is measured every so many
      steps (None: every 50, in a short training at every quarter); after `patience` validations
      without a new best the run stops (None: never).
    - `window`: go back through windows of this many steps, after which a critic tells the worth of
      all that comes (see `windows`); for means only.
    - `clip`: bound on each path's own adjoint at every step (see `engine.Clip`); "auto" finds one
      where gradients explode and leaves all others alone (`solver.learning.clipping`); None: never.
    - `keep`: the share of a path's own adjoint that goes on from one step to the one before it (see
      `engine.Clip`): an outcome k steps after a decision counts keep^k in its gradient. "auto": all
      but where adjoints grow and gradients leap (`solver.learning.clipping`); 1.0: all, always.
    - `spread`: the normals of `initial` times this, in training only: wider starting states.
    - `exploration`: the share of a decision that is drawn at random in training (see
      `learning.practice`); it falls to 0 with the temperature. 0: none. Where it is not given, as
      the decay, if the decisions have bounds.
    - `starts`: so many first weights of the policy's networks begin, and after every tenth of the
      steps the better half goes on (`solver.learning.starts`). None: four where `solve` draws
      them, the steps are not given and a `Choice`, `Whole` or `Stop` decides; else one.
    - `seed`: of the network's first weights and of all scenarios.
    """

    steps: int = FOLLOWS
    paths: int = FOLLOWS
    learning_rate: float = RATE
    warmup: int = 20
    decay: float = DECAY
    temperature_start: float = 0.02
    temperature_end: float = 0.005
    average: float = 0.05
    validation_paths: int = 4096
    validation_every: int | None = None
    patience: int | None = None
    window: int | str | None = "auto"
    clip: float | str | None = "auto"
    keep: float | str = "auto"
    spread: float = 1.0
    exploration: float = EXPLORATION
    starts: int | None = None
    seed: int = 0

    def __post_init__(self):
        for name, least in COUNTS.items():
            value = getattr(self, name)
            given = value is not None and not follows(value)
            if given and (name, value) != ("window", "auto"):
                count(f"Training: {name}", value, least)
        number("Training: learning_rate", self.learning_rate, ABOVE)
        number("Training: decay", self.decay, NOT_BELOW)
        number("Training: temperature_start", self.temperature_start, ABOVE)
        number("Training: temperature_end", self.temperature_end, ABOVE)
        number("Training: average", self.average, SHARE)
        if self.keep != "auto":
            number("Training: keep", self.keep, (SHARE[0], f"{SHARE[1]}, or 'auto'"))
        number("Training: spread", self.spread, ABOVE)
        number("Training: exploration", self.exploration, BELOW_ONE)
        if self.exploration and not self.cools:
            raise ValueError(
                f"Training: exploration is {self.exploration!r} and falls with the temperature, "
                f"but temperature_end, {self.temperature_end!r}, is not below temperature_start, "
                f"{self.temperature_start!r}."
            )
        if isinstance(self.window, str) and self.window != "auto":
            raise ValueError(
                f"Training: window is {self.window!r}; allowed is a number of steps, 'auto' or "
                "None."
            )
        if self.clip is not None and self.clip != "auto":
            number("Training: clip", self.clip, (ABOVE[0], "a number above 0, 'auto' or None"))

    @property
    def cools(self) -> bool:
        """Whether the temperature falls."""
        return self.temperature_end < self.temperature_start

    def temperature(self, step: int) -> float:
        """Geometric from start to end, which is reached at three quarters of the steps."""
        done = min(1.0, step / max(1.0, 0.75 * self.steps))
        return self.temperature_start * (self.temperature_end / self.temperature_start) ** done


COUNTS = {
    "steps": 0, "paths": 1, "warmup": 0, "validation_paths": 1, "validation_every": 1,
    "patience": 1, "window": 1, "starts": 1, "seed": 0,
}  # fmt: skip


def number(name: str, value: object, allowed: tuple[Callable[[float], bool], str]) -> None:
    """Refuses what is no finite number, or not one of those allowed: a test and its words."""
    plain = isinstance(value, int | float | np.integer | np.floating)
    known = float(value) if plain and not isinstance(value, bool) else np.nan
    if not (np.isfinite(known) and allowed[0](known)):
        raise ValueError(f"{name} is {value!r}; allowed is {allowed[1]}.")


ABOVE = (lambda value: value > 0), "a number above 0"
NOT_BELOW = (lambda value: value >= 0), "a number, 0 or more"
BELOW_ONE = (lambda value: 0 <= value < 1), "a number from 0 to below 1"
SHARE = (lambda value: 0 < value <= 1), "a number above 0, at most 1"
