"""D11: the store of G6 with a parallel factor, decided by its dynamic program; see the desk's
reference cases. 100 units, 1 a day, no costs: whole units are best, and the parallel factor does
not change the decisions."""

from datetime import timedelta

import numpy as np
from tests.domains.gas_storage.storage_cases import bare, read

from snapo.domains.gas_storage.hedges.exposures import StorePaths
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.prices.process import GaussianFactors
from snapo.domains.gas_storage.references.intrinsic import intrinsic

DAYS, LEFT, PARALLEL = 365, 0.88, 0.30
SHOCK = 1 / np.sqrt(DAYS)
TIME = np.arange(DAYS + 1)
VARIANCE = SHOCK**2 * (1 - LEFT ** (2 * TIME)) / (1 - LEFT**2)


def dates():
    first = read("G6").days[0]
    return [first + timedelta(n) for n in range(DAYS)]


def curve() -> np.ndarray:
    """[T + 1] with a price of the end."""
    forward = read("G6").market.forward_curve.used()
    return np.append(forward, forward[-1])


def plan() -> np.ndarray:
    """[T + 1] the volumes that the intrinsic plan sells."""
    _, _, schedule = bare(read("G6"))
    return np.append(-intrinsic(schedule, "linear").net, 0.0)


def factors(parallel: float = PARALLEL) -> GaussianFactors:
    loading = np.repeat([[1.0, parallel]], DAYS + 1, axis=0)
    decay = np.repeat([[LEFT, 1.0]], DAYS + 1, axis=0)
    shock = np.repeat([SHOCK * np.eye(2)], DAYS + 1, axis=0)
    decay[0], shock[0] = 1.0, 0.0
    return GaussianFactors(loading, VARIANCE + parallel**2 * TIME / DAYS, decay, shock)


class SlowStore:
    """The exact rule: slopes of the value after each day, on a grid of the fast factor."""

    def __init__(self, nodes: int = 201):
        forward, wide = curve(), np.sqrt(VARIANCE[-1])
        self.x = np.linspace(-6 * wide, 6 * wide, nodes)
        weights = np.exp(-0.5 * ((self.x - LEFT * self.x[:, None]) / SHOCK) ** 2)
        weights = (weights / weights.sum(axis=1, keepdims=True)).T
        value = np.full((101, nodes), -1e9)
        value[0] = 0.0  # empty at the end
        self.slopes = np.empty((DAYS, 100, nodes))
        for t in reversed(range(DAYS)):
            after = value if t == DAYS - 1 else value @ weights
            self.slopes[t] = np.diff(after, axis=0)
            price = forward[t] * np.exp(self.x - VARIANCE[t] / 2)
            value = after.copy()
            value[:-1] = np.maximum(value[:-1], after[1:] - price)
            value[1:] = np.maximum(value[1:], after[:-1] + price)
        self.value = float(value[0, nodes // 2])

    def paths(self, count: int, seed: int, parallel: float = PARALLEL) -> StorePaths:
        """The rule on paths of both factors."""
        prices, forward = factors(parallel), curve()
        states = drawn_states(prices, count, seed)
        level, levels = np.zeros(count, int), np.zeros((DAYS + 1, count))
        sold = np.zeros((DAYS + 1, count))
        for t in range(DAYS):
            price = forward[t] * np.exp(states[t, 0] - VARIANCE[t] / 2)
            more, less = (
                self._slope(t, level, states[t, 0]),
                self._slope(t, level - 1, states[t, 0]),
            )
            into = (level < 100) & (more > price)
            out = (level > 0) & (less < price) & ~into
            level = level + into - out
            sold[t], levels[t + 1] = out.astype(float) - into, level
        spots = PathCurves(prices, forward, states).spots
        money = np.sum(sold * spots, axis=0)
        return StorePaths(prices, forward, np.ones(DAYS + 1), states, levels, sold, money)

    def _slope(self, t: int, level: np.ndarray, x: np.ndarray) -> np.ndarray:
        place = np.clip((x - self.x[0]) / (self.x[1] - self.x[0]), 0, len(self.x) - 1.001)
        node = place.astype(int)
        rows = self.slopes[t][np.clip(level, 0, 99)[:, None], node[:, None] + np.arange(2)]
        return rows[:, 0] + (place - node) * (rows[:, 1] - rows[:, 0])
