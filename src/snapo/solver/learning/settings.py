"""The settings of a training.

Paths, steps, rates and shares that are not specified are chosen from the problem.

A path of many steps contains many decisions, so fewer paths are as informative; and a training step
over a short horizon is cheap, so there is time for more steps. The work of a path is measured by
the multiplications of its network, horizon times parameters, which are the same on every machine.

More steps allow a higher learning rate, which falls to zero at the end; wider layers need a lower
one, since all their weights move at once. A `Stop`, also in a `Product`, keeps the usual rate: its
features are scaled, and a put ended at 4.459 with the higher rate, and at 4.472 with the usual one.

If many numbers are decided, one of them may get stuck at a limit where its gradient is zero: for
example, a battery that always discharges at midnight, when it is empty. There are two remedies. A
tenth of every decision is drawn at random at first, which visits states that the rule does not. And
weights decay, to a quarter over all steps of any training, since no gradient opposes the decay
there. Ten batteries earned, relative to the best, 93.6 to 97.0 % with neither, 94.1 to 96.2 % with
the decay only, 95.7 to 97.7 % with both; of the first five with exploration only, one earned 94.4
%. Twelve stocks of known optimum, over 3,840 steps, cost 0.13 % too much with neither and 0.17 %
with both; 0.45 and 0.48 % with a decay of 0.2, seven times as large.

A `Choice`, `Integers` or `Stop` decides between few values, so that the initial weights matter
more: training begins from several of them and continues with the better half (`starts`).

A rule fitted to the best mean is at the optimum up to the error of its fit, but the smooth problem
used in training has another optimum: in the examples of a store, a swing contract, a battery, a
park and loan and a plant, 20 to 120 steps gained nothing, or 0.03 % (battery); the store's 120
steps lost 128 ± 54 of 78,377. A few small steps show whether more would gain anything (`FITTED`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

import jax
import numpy as np

from snapo.problem.actions import Actions, Choice, Integers, Stop, contains
from snapo.problem.actions.sets import count
from snapo.problem.policy import Network, Policy, parameters
from snapo.problem.problem import Problem

Auto = Literal["auto"]
RATE = 0.01  # of Adam, if nothing else is chosen
FOLLOWING = (  # settings that may be "auto"
    "steps", "paths", "learning_rate", "decay", "exploration", "validation_every", "starts",
)  # fmt: skip
USUAL_STEPS = 240  # of a case
# Of a case whose policy begins from a fitted rule.
FITTED = {"steps": 20, "learning_rate": 0.001, "validation_every": 10}
EVERY, QUARTERS = 50, 4  # steps between two validations, at most; parts of a training, at least


@dataclass(frozen=True)
class Training:
    """How a policy is trained; "auto" is chosen from the problem.

    - `steps`, `paths`: the number of updates, and of fresh antithetic paths for each update.
      "auto": chosen from the horizon and the size of the policy.
    - `learning_rate`, `warmup`: Adam's peak rate, reached linearly in `warmup` steps, then cosine
      decay to zero. "auto": 0.01, or if the steps are "auto" too, chosen with them.
    - `decay`: the decay of weights, per step, times the learning rate (AdamW). "auto": 0; if the
      steps are "auto" too, above 0 if more than eight numbers are decided in one step.
    - `temperature_start`, `temperature_end`: the temperature of the smooth constraints falls
      geometrically from one to the other.
    - `average`: the policy is averaged over about this share of the steps.
    - `validation_paths`, `validation_every`, `patience`: the exact value is measured every
      `validation_every` steps ("auto": every 50, in a short training at every quarter); after
      `patience` validations without a new best the run stops (None: never).
    - `window`: backpropagate through windows of this many steps, after which a critic gives the
      continuation value (see `windows`); for means only.
    - `clip`: bound on each path's adjoint at every step (see `engine.Clip`); "auto" sets one only
      where gradients explode (`learning.conditioning`); None: never.
    - `keep`: the share of a path's adjoint that is passed from one step to the one before it (see
      `engine.Clip`): an outcome k steps after a decision counts keep^k in its gradient. "auto": 1
      unless adjoints grow and gradients jump (`learning.conditioning`); 1.0: always 1.
    - `spread`: factor on the normals of `initial`, in training only, which gives wider initial
      states.
    - `exploration`: the share of a decision that is drawn at random in training; it falls to 0 with
      the temperature. 0: none. "auto": chosen as `decay` is, if the decisions have bounds.
    - `starts`: the number of initial weights of the policy's networks from which training begins;
      after every tenth of the steps it continues with the better half (`solver.learning.starts`).
      "auto": four where `solve` draws them, `steps` is "auto" too and the action is a `Choice`,
      `Integers` or `Stop`; else one.
    - `seed`: the seed of the network's initial weights and of all scenarios.
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
                f"Training: window is {self.window!r}; it must be a number of steps, 'auto' or "
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
    """Settings with numbers instead of "auto"; `automatic`: the settings that were "auto"."""

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
    def from_settings(cls, settings: Mapping[str, Any], fitted: bool = False) -> "TrainingPlan":
        """The training for the settings of a case; a setting that is missing or None has its
        default. `fitted`: whether the policy begins from a rule that was fitted to the best mean,
        with all risks of the prices.
        """
        numbers: dict[str, Any] = {k: value for k, value in settings.items() if value is not None}
        if "steps" not in numbers:
            numbers = (FITTED if fitted else {"steps": USUAL_STEPS}) | numbers
        numbers = {"validation_every": every(numbers["steps"])} | numbers
        return cls(**numbers)

    @classmethod
    def of(cls, training: Training, **numbers: Any) -> "TrainingPlan":
        """The plan of a training, with these numbers instead of every "auto"."""
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
    """The default number of steps between two validations."""
    return min(EVERY, max(1, -(-steps // QUARTERS)))


COUNTS = {
    "steps": 0, "paths": 1, "warmup": 0, "validation_paths": 1, "validation_every": 1,
    "patience": 1, "window": 1, "starts": 1, "seed": 0,
}  # fmt: skip


def number(name: str, value: object, allowed: tuple[Callable[[float], bool], str]) -> None:
    """Refuses a value that is not a finite number or fails the test `allowed`: (test, text)."""
    plain = isinstance(value, int | float | np.integer | np.floating)
    available = float(value) if plain and not isinstance(value, bool) else np.nan
    if not (np.isfinite(available) and allowed[0](available)):
        raise ValueError(f"{name} is {value!r}; it must be {allowed[1]}.")


ABOVE = (lambda value: value > 0), "a number above 0"
NOT_BELOW = (lambda value: value >= 0), "a number, 0 or more"
BELOW_ONE = (lambda value: 0 <= value < 1), "a number from 0 to below 1"
SHARE = (lambda value: 0 < value <= 1), "a number above 0, at most 1"
NUMBERS = {
    "learning_rate": ABOVE, "decay": NOT_BELOW, "temperature_start": ABOVE,
    "temperature_end": ABOVE, "average": SHARE, "spread": ABOVE, "exploration": BELOW_ONE,
}  # fmt: skip


WORK = 1.2e8  # products of one step of training: some 0.01 s on two cores
PATHS = (16, 512)  # at least, at most
ALIKE = 64  # at most, where all paths are one
STEPS = (240, 3840)
USUAL = 480  # steps, at a horizon of 100, up to which `RATE` is right: a plant's must not leap
WIDTH = 32  # of hidden layers at which it is
MANY = 8  # numbers decided in one step, above which weights decay and decisions explore
LEFT = 1 / 4  # of a weight that nothing holds, after all steps
EXPLORED = 0.1  # share of a decision
SEVERAL = 4  # initial weights, if decisions are of few values
LONG = 96_000  # steps of the simulator that all steps of training go through, on one path
RATED = 48_000  # the same, of the steps that the rate follows: chosen before there were more


def resolve_auto(
    training: Training, problem: Problem, policy: Policy, fresh: bool = False
) -> TrainingPlan:
    """The training with all "auto" settings resolved from the problem.

    `fresh`: whether the policy's networks were drawn for it, so that others may be drawn.
    """
    if isinstance(training, TrainingPlan):
        return training
    paths, steps, rate = training.paths, training.steps, training.learning_rate
    decay, exploring, free = training.decay, training.exploration, training.steps == "auto"
    if exploring == "auto":
        exploring = EXPLORED if free and _explores(problem.action, training) else 0.0
    horizon, certain = problem.simulator.horizon, exploring == 0 and not problem.is_random
    if paths == "auto":
        work = horizon * max(1, parameters(policy).size)
        paths = _within(PATHS, 2 ** round(math.log2(max(1.0, WORK / work))))
        paths = min(paths, ALIKE) if certain else paths
    # The gradient of fewer paths is noisier, which more steps average out.
    noisy = (PATHS[1] / paths) ** 0.4 if paths < PATHS[1] and not certain else 1.0
    if steps == "auto":
        steps = round(noisy * _within(STEPS, LONG // horizon))
    if rate == "auto":
        rate = RATE
        if free and not contains(problem.action, Stop):
            usual = _within(STEPS, RATED // horizon)
            many = usual / STEPS[0] if usual > USUAL else 1.0
            rate *= math.sqrt(noisy * many)
            rate *= min(1.0, WIDTH / _width(policy)) ** 0.25
    if decay == "auto":
        # The rate falls to zero by a cosine, so that it is half as large on average.
        decay = -2 * math.log(LEFT) / (rate * steps) if free and problem.action.size > MANY else 0.0
    few_values = any(contains(problem.action, kind) for kind in (Choice, Integers, Stop))
    starts = SEVERAL if fresh and free and few_values else 1
    return TrainingPlan.of(
        training, paths=paths, steps=steps, learning_rate=rate, decay=decay, exploration=exploring,
        validation_every=every(steps), starts=starts,
    )  # fmt: skip


def _explores(action: Actions, training: Training) -> bool:
    """Whether a share of these decisions can be drawn, and they are many. Decisions must have
    bounds, within which they are drawn, and the temperature must fall, since the share falls with
    it."""
    bounded = all(np.isfinite(bound).all() for bound in action.bounds())
    return action.exploration_size > MANY and bounded and training.cools


def _width(policy: Policy) -> int:
    """The number of units in the widest layer of all networks; 1 if there is none."""
    nodes = jax.tree.leaves(policy, is_leaf=lambda node: isinstance(node, Network))
    networks = [node for node in nodes if isinstance(node, Network)]
    return max((bias.size for network in networks for bias in network.biases[:-1]), default=1)


def _within(limits: tuple[int, int], number: int) -> int:
    return min(limits[1], max(limits[0], number))
