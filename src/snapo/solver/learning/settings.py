"""The settings of a training."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

import numpy as np

from snapo.problem.actions.base import count

Auto = Literal["auto"]
RATE = 0.01  # of Adam, where nothing else is chosen
FOLLOWING = (  # what may be "auto"
    "steps", "paths", "learning_rate", "decay", "exploration", "validation_every", "starts",
)  # fmt: skip
EVERY, QUARTERS = 50, 4  # steps between two validations, at most; parts of a training, at least


@dataclass(frozen=True)
class Training:
    """How a policy is trained; what is "auto" is chosen when the problem is known.

    - `steps`, `paths`: updates, and antithetic fresh paths for each. "auto": they follow the
      horizon and the size of the policy (`solver.learning.following`).
    - `learning_rate`, `warmup`: Adam's peak rate, reached linearly in `warmup` steps, then cosine
      decay to zero. "auto": 0.01, and where the steps are "auto" too, it follows them.
    - `decay`: the share that a step takes off every trained number, times the rate (AdamW). "auto":
      0, and where the steps are "auto" too, above 0 for more than eight decisions in one step.
    - `temperature_start`, `temperature_end`: of the smooth constraints, annealed geometrically.
    - `average`: the averaged policy remembers about this share of the steps.
    - `validation_paths`, `validation_every`, `patience`: the exact value is measured every so many
      steps ("auto": every 50, in a short training at every quarter); after `patience` validations
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
      `learning.practice`); it falls to 0 with the temperature. 0: none. "auto": as the decay, if
      the decisions have bounds.
    - `starts`: so many first weights of the policy's networks begin, and after every tenth of the
      steps the better half goes on (`solver.learning.starts`). "auto": four where `solve`
      draws them, the steps are "auto" too and a `Choice`, `Integers` or `Stop` decides; else one.
    - `seed`: of the network's first weights and of all scenarios.
    """

    steps: int | Auto = "auto"
    paths: int | Auto = "auto"
    learning_rate: float | Auto = "auto"
    warmup: int = 20
    decay: float | Auto = "auto"
    temperature_start: float = 0.02
    temperature_end: float = 0.005
    average: float = 0.05
    validation_paths: int = 4096
    validation_every: int | Auto = "auto"
    patience: int | None = None
    window: int | str | None = "auto"
    clip: float | str | None = "auto"
    keep: float | str = "auto"
    spread: float = 1.0
    exploration: float | Auto = "auto"
    starts: int | Auto = "auto"
    seed: int = 0
    _free: ClassVar[tuple[str, ...]] = FOLLOWING

    def __post_init__(self):
        free = self._free
        for name, minimum in COUNTS.items():
            value, more = getattr(self, name), " or 'auto'" if name in free else ""
            none = value is None and name in ("patience", "window")
            auto = value == "auto" and name in (*free, "window")
            if not (none or auto):
                count(f"Training: {name}", value, minimum, more)
        for name, (test, text) in NUMBERS.items():
            value, more = getattr(self, name), " or 'auto'" if name in free else ""
            if not (more and value == "auto"):
                number(f"Training: {name}", value, (test, text + more))
        if self.keep != "auto":
            number("Training: keep", self.keep, (SHARE[0], f"{SHARE[1]}, or 'auto'"))
        if self.exploration not in (0, "auto") and not self.cools:
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


@dataclass(frozen=True)
class TrainingPlan(Training):
    """A training with numbers in place of every "auto"; `automatic`: the settings that were."""

    steps: int = 0
    paths: int = 2
    learning_rate: float = RATE
    decay: float = 0.0
    exploration: float = 0.0
    validation_every: int = EVERY
    starts: int = 1
    automatic: tuple[str, ...] = ()
    _free: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "automatic", tuple(self.automatic))

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> "TrainingPlan":
        """The plan of a case's numbers; one that is None or missing has its usual value."""
        numbers: dict[str, Any] = {"validation_every": every(settings["steps"])}
        numbers |= {name: value for name, value in settings.items() if value is not None}
        return cls(**numbers)

    @classmethod
    def of(cls, training: Training, **numbers: Any) -> "TrainingPlan":
        """The plan of a training, with these numbers in place of what is "auto" in it."""
        by_name = {field.name: getattr(training, field.name) for field in fields(training)}
        free = tuple(name for name in FOLLOWING if by_name[name] == "auto")
        available = {name: value for name, value in by_name.items() if name not in free}
        selected = {name: value for name, value in numbers.items() if name in free}
        settings: dict[str, Any] = {"automatic": free} | available | selected
        return cls(**settings)

    def temperature(self, step: int) -> float:
        """Geometric from start to end, which is reached at three quarters of the steps."""
        done = min(1.0, step / max(1.0, 0.75 * self.steps))
        return self.temperature_start * (self.temperature_end / self.temperature_start) ** done


def every(steps: int) -> int:
    """Steps between two validations, where nothing is chosen."""
    return min(EVERY, max(1, -(-steps // QUARTERS)))


COUNTS = {
    "steps": 0, "paths": 1, "warmup": 0, "validation_paths": 1, "validation_every": 1,
    "patience": 1, "window": 1, "starts": 1, "seed": 0,
}  # fmt: skip


def number(name: str, value: object, allowed: tuple[Callable[[float], bool], str]) -> None:
    """Refuses what is no finite number, or not one of those allowed: a test and its words."""
    plain = isinstance(value, int | float | np.integer | np.floating)
    available = float(value) if plain and not isinstance(value, bool) else np.nan
    if not (np.isfinite(available) and allowed[0](available)):
        raise ValueError(f"{name} is {value!r}; allowed is {allowed[1]}.")


ABOVE = (lambda value: value > 0), "a number above 0"
NOT_BELOW = (lambda value: value >= 0), "a number, 0 or more"
BELOW_ONE = (lambda value: 0 <= value < 1), "a number from 0 to below 1"
SHARE = (lambda value: 0 < value <= 1), "a number above 0, at most 1"
NUMBERS = {
    "learning_rate": ABOVE, "decay": NOT_BELOW, "temperature_start": ABOVE,
    "temperature_end": ABOVE, "average": SHARE, "spread": ABOVE, "exploration": BELOW_ONE,
}  # fmt: skip
