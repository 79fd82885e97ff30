"""A grid for one or two price factors, and the exact Gaussian transitions between its nodes.

The fast factor has a fine uniform grid and the trapezoidal rule against the exact transition
density: for a smooth integrand its error falls faster than any power of the spacing (Trefethen and
Weideman, SIAM Review 56, 2014), and the kinks that decisions leave cost order spacing squared.
The slow factor has few nodes: Gauss-Hermite quadrature of a cubic spline through them.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ..prices.process import GaussianFactors

# Where a grid ends, in standard deviations of its factor at its widest.
FAST_REACH, SLOW_REACH = 6.0, 4.5
# The trapezoidal rule needs a transition at least this wide, in spacings of the grid.
NARROW = 0.7
MAX_NODES = 401


class Transition(NamedTuple):
    """A sum of products: slow weights [from, to] x fast weights [from, to], for each term."""

    terms: list[tuple[np.ndarray, np.ndarray]]

    def expect(self, value: np.ndarray) -> np.ndarray:
        """Conditional expectation: [n, slow to x fast to] -> [n, slow from x fast from]."""
        total = 0.0
        for slow, fast in self.terms:
            moved = value.reshape(-1, slow.shape[1], fast.shape[1]) @ fast.T
            total = total + (slow @ moved if slow.size > 1 else slow[0, 0] * moved)
        return np.reshape(total, (len(value), -1))

    def spread(self, weight: np.ndarray) -> np.ndarray:
        """The transpose of `expect`: weights (probabilities) on the nodes a day later."""
        total = 0.0
        for slow, fast in self.terms:
            moved = weight.reshape(-1, slow.shape[0], fast.shape[0]) @ fast
            total = total + (slow.T @ moved if slow.size > 1 else slow[0, 0] * moved)
        return np.reshape(total, (len(weight), -1))


@dataclass(frozen=True, eq=False)
class FactorGrid:
    """Nodes of the kept factors, the same on all days; columns run over slow x fast nodes.

    - `of`: all factors of the price process; `selected`: indices of those on the grid, fast one
      first.
    - `fast`, `slow`: node positions (slow: one node at 0 where a single factor is kept).
    - `covariance`: [T + 1, kept, kept] of the kept factors on each day, and on the end date.
    """

    of: GaussianFactors
    selected: tuple[int, ...]
    fast: np.ndarray
    slow: np.ndarray
    covariance: np.ndarray
    _known: dict = field(default_factory=dict)

    @property
    def columns(self) -> int:
        return len(self.slow) * len(self.fast)

    def noise(self, t: int) -> np.ndarray:
        """Spot over forward price [columns] on day t (T: on the end date), of mean 1."""
        loading = self.of.loading[t][list(self.selected)]
        variance = loading @ self.covariance[t] @ loading
        log = loading[0] * self.fast[None, :]
        if len(self.selected) > 1:
            log = log + loading[1] * self.slow[:, None]
        return np.exp(log - variance / 2).ravel()

    def start(self) -> Transition:
        """From the valuation date, where all factors are 0, to the first day (one row)."""
        return self._transition(0, np.zeros(1), np.zeros(1))

    def after(self, t: int) -> Transition:
        """From day t to the next day, or to the end date."""
        return self._transition(t + 1, self.slow, self.fast)

    def _transition(self, into: int, slow, fast) -> Transition:
        selected, decay, shock = list(self.selected), self.of.decay[into], self.of.shock[into]
        covariance = (shock @ shock.T)[np.ix_(selected, selected)]
        key = (len(slow), len(fast), *(f"{x:.9e}" for x in [*decay[selected], *covariance.ravel()]))
        if key not in self._known:
            self._known[key] = _weights(self, decay[selected], covariance, slow, fast)
        return self._known[key]


def factor_grid(
    of: GaussianFactors, selected: tuple[int, ...], spacing: float, slow_nodes: int
) -> FactorGrid:
    """The grid for one or two factors; `spacing` in standard deviations of the fast daily shock."""
    covariance = _covariance(of, list(selected))
    widest = np.sqrt(np.max(covariance[:, range(len(selected)), range(len(selected))], axis=0))
    shocks = of.shock[:, selected[0]]
    daily = np.sqrt(np.sum(shocks**2, axis=1))
    daily = daily[daily > 1e-12 * max(widest[0], 1e-300)]
    fast = np.zeros(1)
    if len(daily) and widest[0] > 0:
        half = FAST_REACH * widest[0] / (spacing * daily.min())
        fast = np.linspace(-1, 1, 2 * min(int(np.ceil(half)), MAX_NODES // 2) + 1)
        fast = FAST_REACH * widest[0] * fast
    slow = np.zeros(1)
    if len(selected) > 1 and widest[1] > 0:
        slow = np.linspace(-1, 1, slow_nodes | 1) * SLOW_REACH * widest[1]
    return FactorGrid(of, tuple(selected), fast, slow, covariance)


def _covariance(of: GaussianFactors, selected: list[int]) -> np.ndarray:
    covariance, covariances = np.zeros((len(selected), len(selected))), []
    for decay, shock in zip(of.decay[:, selected], of.shock[:, selected], strict=True):
        covariance = np.outer(decay, decay) * covariance + shock @ shock.T
        covariances.append(covariance)
    return np.array(covariances)


def _weights(grid: FactorGrid, decay, covariance, slow, fast) -> Transition:
    """Independent factors need one term; correlated ones a term per shock of the slow factor."""
    if len(grid.slow) == 1:
        local = _from_points(grid.fast, decay[0] * fast, np.sqrt(covariance[0, 0]))
        return Transition([(np.ones((1, 1)), local)])
    shocks, probabilities = _gauss_hermite(np.sqrt(covariance[1, 1]), 3)
    positions = [_spline_weights(grid.slow, decay[1] * slow + shock) for shock in shocks]
    if covariance[0, 1] == 0:
        moved = np.tensordot(probabilities, np.array(positions), axes=1)
        local = _from_points(grid.fast, decay[0] * fast, np.sqrt(covariance[0, 0]))
        return Transition([(moved, local)])
    slope = covariance[0, 1] / covariance[1, 1]
    rest = np.sqrt(max(covariance[0, 0] - slope * covariance[0, 1], 0.0))
    return Transition(
        [
            (probability * position, _from_points(grid.fast, decay[0] * fast + slope * shock, rest))
            for probability, position, shock in zip(probabilities, positions, shocks, strict=True)
        ]
    )


def _from_points(nodes: np.ndarray, mean: np.ndarray, deviation: float) -> np.ndarray:
    """Weights [points, nodes] of the expectation over N(mean, deviation^2)."""
    if len(nodes) == 1:
        return np.ones((len(mean), 1))
    if deviation < NARROW * (nodes[1] - nodes[0]):
        shocks, probabilities = _gauss_hermite(deviation, 7)
        positions = [_spline_weights(nodes, mean + shock) for shock in shocks]
        return np.tensordot(probabilities, np.array(positions), axes=1)
    density = np.exp(-0.5 * ((nodes[None, :] - mean[:, None]) / deviation) ** 2)
    return density / density.sum(axis=1, keepdims=True)


def _gauss_hermite(deviation: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Shocks and their probabilities; one shock of 0 where there is no noise."""
    if deviation == 0:
        return np.zeros(1), np.ones(1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return deviation * nodes, weights / weights.sum()


def _spline_weights(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Natural cubic spline interpolation as weights [points, nodes], flat outside the nodes."""
    spline = CubicSpline(nodes, np.eye(len(nodes)), bc_type="natural")
    return spline(np.clip(points, nodes[0], nodes[-1]))
