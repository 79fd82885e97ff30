"""The real environment: every step is counted, and every transition kept."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..installed import gymnasium
from ..played import made
from .transitions import Transitions

MAX_DECISIONS = 250  # of an episode, where nobody says how long a decision is held
Act = Callable[[np.ndarray, int], np.ndarray]  # from observation and decision's number to action


class Episode(NamedTuple):
    """One episode: its transitions, the sum of its rewards, and the steps that it took."""

    rows: Transitions
    total: float
    steps: int
    start: np.ndarray


class Real:
    """A Gymnasium environment whose decisions are held for `hold` steps each.

    **Raises:** `ValueError` where observations or actions are no numbers in a box, or where nothing
    limits the length of an episode.
    """

    def __init__(self, environment: Any, hold: int | None, limit: int | None):
        self.inner = inner = opened(environment)
        observed, self.actions = _box(inner, "observation"), _box(inner, "action")
        if not (np.isfinite(self.actions.low).all() and np.isfinite(self.actions.high).all()):
            raise ValueError("learn: the actions need a finite low and high, to be explored.")
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
        """Numbers in an action."""
        return int(np.prod(self.actions.shape))

    def episode(self, act: Act, seed: int) -> Episode:
        """Plays one episode to its end."""
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
    """An environment of which every action is held for `hold` steps, their rewards added up.

    An episode is over after `limit` steps of the environment inside; `taken` are those so far.
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
    """The environment of a name, of a function that makes it, or itself."""
    return environment if isinstance(environment, gymnasium.Env) else made(environment)


FLATTEN = "gymnasium.wrappers.FlattenObservation makes a box of it"
SCORES = (
    "the adjoint needs numbers that can move a little. A gymnasium.ActionWrapper can take a Box of "
    "scores, one for each choice, and choose the largest"
)
REMEDIES = {"observation": FLATTEN, "action": SCORES}


def _box(environment: Any, name: str):
    """A space of the environment, which must be a box."""
    space = getattr(environment, f"{name}_space", None)
    if not isinstance(space, gymnasium.spaces.Box):
        raise ValueError(
            f"learn: the {name} space is {space}, and a Box of numbers is needed: {REMEDIES[name]}."
        )
    return space


def _limit(environment: Any, values: int | None) -> int:
    spec = getattr(environment, "spec", None)
    limit = values or getattr(spec, "max_episode_steps", None) or _of_wrapper(environment)
    if not limit:
        raise ValueError(
            "learn: nothing limits the length of an episode; give limit=200, say, in steps."
        )
    return int(limit)


def _of_wrapper(environment: Any) -> int | None:
    """That of a `TimeLimit` around an environment that is not registered, and so has no spec."""
    while isinstance(environment, gymnasium.Wrapper):
        if isinstance(environment, gymnasium.wrappers.TimeLimit):
            return environment._max_episode_steps
        environment = environment.env
    return None


def _flat(observed: Any) -> np.ndarray:
    return np.asarray(observed, np.float32).reshape(-1)
