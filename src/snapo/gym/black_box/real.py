"""The real environment: every step is counted, and every transition is stored and scaled."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from snapo.problem.policy import MLP
from snapo.solver.learning.features import layers, plain, scaled

from ..environments import made
from ..spaces import gymnasium

MINIMUM = 1e-6  # of a scale, as a share of the size of its numbers
ON_CIRCLE = 1e-3  # of the sum of two squares, at every observation


class Transitions(NamedTuple):
    """Steps of the environment, one in each row; with `hold`, a row covers all steps of a held
    decision. `ended` is true if the environment terminated. Truncation at a time limit does not
    count as an end, since it does not depend on the state.
    """

    before: Float[np.ndarray, "n k"]
    action: Float[np.ndarray, "n m"]
    reward: Float[np.ndarray, " n"]
    after: Float[np.ndarray, "n k"]
    ended: Bool[np.ndarray, " n"]

    @property
    def count(self) -> int:
        return self.before.shape[0]


def joined(parts: list[Transitions]) -> Transitions:
    """All transitions, in their order."""
    return Transitions(*(np.concatenate(part) for part in zip(*parts)))


def circles(observed: Float[np.ndarray, "n k"]) -> tuple[tuple[int, int], ...]:
    """Pairs of observed numbers, a cosine and a sine, that are on the unit circle in all rows.

    A model that leaves the circle slightly at every step evaluates its networks at impossible
    states, so these pairs are projected back onto the circle.
    """
    pairs: list[tuple[int, int]] = []
    free = list(range(observed.shape[1]))
    while free:
        i = free.pop(0)
        for j in free:
            on = np.abs(observed[:, i] ** 2 + observed[:, j] ** 2 - 1) < ON_CIRCLE
            moves = min(np.ptp(observed[:, i]), np.ptp(observed[:, j])) > ON_CIRCLE
            if on.all() and moves:
                pairs.append((i, j))
                free.remove(j)
                break
    return tuple(pairs)


def scale_of(
    rows: Float[np.ndarray, "n k"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and standard deviation of columns; a constant column has a scale of one."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.ones(rows.shape[1])
    mean, deviation = rows.mean(0), rows.std(0)
    still = deviation <= MINIMUM * np.maximum(np.abs(mean), 1e-30)
    return mean, np.where(still, 1.0, deviation)


MAX_DECISIONS = 250  # of an episode, where the time for which a decision is held is not specified
Act = Callable[[np.ndarray, int], np.ndarray]  # from observation and decision's number to action


class Episode(NamedTuple):
    """One episode: its transitions, the sum of its rewards, and the number of its steps."""

    rows: Transitions
    total: float
    steps: int
    start: np.ndarray


class Real:
    """A Gymnasium environment in which every decision is held for `hold` steps.

    **Raises:** `ValueError` if observations or actions are not numbers in a box, or if the length
    of an episode has no limit.
    """

    def __init__(self, environment: Any, hold: int | None, limit: int | None):
        self.inner = inner = opened(environment)
        observed, self.actions = _box(inner, "observation"), _box(inner, "action")
        if not (np.isfinite(self.actions.low).all() and np.isfinite(self.actions.high).all()):
            raise ValueError("learn: the action space must have finite bounds low and high.")
        self.low, self.high = (
            np.ravel(item).astype(np.float64) for item in (observed.low, observed.high)
        )
        self.limit = _limit(inner, limit)
        self.hold = hold if hold is not None else max(1, -(-self.limit // MAX_DECISIONS))
        self.decisions = -(-self.limit // self.hold)
        self.environment = HeldAction(inner, self.hold, self.limit)
        self.steps = 0

    @property
    def size(self) -> int:
        """The number of entries of an action."""
        return int(np.prod(self.actions.shape))

    def episode(self, act: Act, seed: int) -> Episode:
        """Plays one complete episode."""
        observed, _ = self.environment.reset(seed=int(seed))
        start = observed = _flat(observed)
        rows, done = [], False
        while not done:
            action = np.asarray(act(observed, len(rows)), np.float32).reshape(-1)
            shaped = action.reshape(self.actions.shape)
            result, reward, ended, late, _ = self.environment.step(shaped)
            before, observed, done = observed, _flat(result), ended or late
            rows.append((before, action, reward, observed, ended))
        self.steps += self.environment.taken
        kinds = (np.float32, np.float32, np.float64, np.float32, bool)
        columns = [np.asarray(row, kind) for row, kind in zip(zip(*rows), kinds)]
        total = float(columns[2].sum())
        return Episode(Transitions(*columns), total, self.environment.taken, start)


class HeldAction(gymnasium.Wrapper):
    """An environment with every action held for `hold` steps, whose rewards are added up.

    An episode is over after `limit` steps of the inner environment; `taken` counts them.
    """

    def __init__(self, environment: Any, hold: int, limit: int):
        super().__init__(environment)
        self.hold, self.limit, self.taken = hold, limit, 0

    def reset(self, **options):
        self.taken = 0
        return super().reset(**options)

    def step(self, action):
        total, ended, late = 0.0, False, False
        observed, info = None, {}
        for _ in range(self.hold):
            observed, reward, ended, late, info = super().step(action)
            self.taken += 1
            total, late = total + float(reward), bool(late) or self.taken >= self.limit
            if ended or late:
                break
        return observed, total, bool(ended), late, info


def opened(environment: Any):
    """The environment, made from its name or by a function, or the object itself."""
    return environment if isinstance(environment, gymnasium.Env) else made(environment)


FLATTEN = "gymnasium.wrappers.FlattenObservation converts it to a box"
SCORES = (
    "the adjoint method needs continuous actions. A gymnasium.ActionWrapper can take a Box of "
    "scores, one for each choice, and choose the option with the largest score"
)
REMEDIES = {"observation": FLATTEN, "action": SCORES}


def _box(environment: Any, name: str):
    """Returns a space of the environment, which must be a box."""
    space = getattr(environment, f"{name}_space", None)
    if not isinstance(space, gymnasium.spaces.Box):
        raise ValueError(
            f"learn: the {name} space is {space}, but it must be a Box of numbers: "
            f"{REMEDIES[name]}."
        )
    return space


def _limit(environment: Any, values: int | None) -> int:
    spec = getattr(environment, "spec", None)
    limit = values or getattr(spec, "max_episode_steps", None) or _of_wrapper(environment)
    if not limit:
        raise ValueError(
            "learn: the length of an episode has no limit; specify one in steps, such as limit=200."
        )
    return int(limit)


def _of_wrapper(environment: Any) -> int | None:
    """The limit in the `TimeLimit` wrapper of an environment that is not registered and therefore
    has no spec."""
    while isinstance(environment, gymnasium.Wrapper):
        if isinstance(environment, gymnasium.wrappers.TimeLimit):
            return environment._max_episode_steps
        environment = environment.env
    return None


def _flat(observed: Any) -> np.ndarray:
    return np.asarray(observed, np.float32).reshape(-1)


class Units(NamedTuple):
    """Shift and scale [k] of a policy's observations in training. They are fixed, since weights
    depend on them."""

    shift: np.ndarray
    scale: np.ndarray

    def undone(self, policy: MLP) -> MLP:
        """The policy for unscaled observations of the environment. It is an ordinary network, so it
        can be saved and exported like every policy."""
        return _with_layer(policy, plain(*_layer(policy), self.shift, self.scale))

    def done(self, policy: MLP) -> MLP:
        """The inverse of `undone`."""
        return _with_layer(policy, scaled(*_layer(policy), self.shift, self.scale))


@dataclass
class Known:
    """The real environment and all episodes so far.

    `units` and `circles` (see the function) are determined from the random episodes.
    """

    real: Real
    rng: np.random.Generator
    units: Units
    circles: tuple[tuple[int, int], ...] = ()
    episodes: list[Episode] = field(default_factory=list)

    @staticmethod
    def of(real: Real, seed: int) -> "Known":
        """An environment in which no episode has been played."""
        nothing = Units(np.zeros(0), np.ones(0))
        return Known(real, np.random.default_rng((seed, 1)), nothing)

    def settled(self) -> "Known":
        """The same environment with units from all transitions so far."""
        observed = self.transitions
        every = np.concatenate([observed.before, observed.after]).astype(np.float64)
        return replace(self, units=Units(*scale_of(every)), circles=circles(every))

    @property
    def transitions(self) -> Transitions:
        """All transitions."""
        return joined([episode.rows for episode in self.episodes])

    @property
    def firsts(self) -> Float[np.ndarray, "n k"]:
        """The first observations of all episodes."""
        return np.stack([episode.start for episode in self.episodes])

    def play(self, act: Act, seed: int | None = None) -> Episode:
        """Plays one more episode, records it and returns it."""
        seed = int(self.rng.integers(2**31)) if seed is None else seed
        self.episodes.append(self.real.episode(act, seed))
        return self.episodes[-1]

    def room(self, steps: float) -> bool:
        """Whether one more episode, whatever its length, fits into this number of steps."""
        return self.real.steps + self.real.limit <= steps


def _layer(policy: MLP) -> tuple[np.ndarray, np.ndarray]:
    """Weights and biases of the first layer, in float64, so that numbers far from zero lose no
    digits."""
    weights, bias = layers(policy)[0]
    return np.asarray(weights, np.float64), np.asarray(bias, np.float64)


def _with_layer(policy: MLP, numbers) -> MLP:
    first = tuple(jnp.asarray(number, jnp.float32) for number in numbers)
    return eqx.tree_at(lambda item: layers(item)[0], policy, first)
