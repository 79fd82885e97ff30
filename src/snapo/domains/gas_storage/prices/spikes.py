"""The law of the spikes of a price, for dynamic programs: y(t + 1) = decay y(t) + J.

J >= 0 is the effect, at the end of a day, of the spikes of this day, and is independent of the
past. It is at most one spike of exponential size ("Bernoulli"), or the remainder of a compound
Poisson process. Everything here is plain NumPy.
"""

from typing import NamedTuple

import numpy as np

REACH = 30.0  # of the exponent of the density times exp(J), up to which that is integrated
PANELS = 48  # of the quadrature, with 4 nodes each


class Spikes(NamedTuple):
    """Spikes of ln S: log-price + y - compensator.

    - `decay`: the share of a spike that is left after a day; `size`: the mean of a spike.
    - `rate`: spikes per day; `poisson`: whether several spikes may occur, and decay, within a day.
    - `before`: the number of days from the valuation date, when there are no spikes, to the first
      date.
    - `compensator` [T + 1]: ln E[exp y] on each date.
    """

    decay: float
    size: float
    rate: float
    poisson: bool
    before: int
    compensator: np.ndarray

    def moment(self, exponent: np.ndarray) -> np.ndarray:
        """E[exp(exponent J)], for exponents below 1 / size."""
        x = self.size * exponent
        if self.poisson:
            return ((1 - self._left * x) / (1 - x)) ** self._shape
        chance = -np.expm1(-self.rate)
        return 1 - chance + chance / (1 - x)

    def first_moment(self, exponent: np.ndarray) -> np.ndarray:
        """E[exp(exponent y)] on the first date."""
        result = np.ones_like(exponent)
        for day in range(self.before):
            result = result * self.moment(exponent * self.decay**day)
        return result

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and probabilities of J; the first is the case without a spike."""
        nodes, weights = np.polynomial.legendre.leggauss(4)
        edges = REACH / (1 - self.size) * (np.arange(PANELS + 1) / PANELS) ** 2
        half = np.diff(edges) / 2
        x = (edges[:-1, None] + half[:, None] * (nodes + 1)).ravel()
        density = np.exp(-x)  # in mean sizes
        none = np.exp(-self.rate)
        if self.poisson:
            # A negative binomial number of exponentials: Kummer's form of the mixture of gammas.
            shape, left = self._shape, self._left
            z = x * (1 - left) / left
            from scipy.special import hyp1f1  # late: a case is checked without it

            density = density * hyp1f1(1 - shape, 2, -z) * shape * (1 - left) / left
        mass = density * (half[:, None] * weights).ravel()
        mass = mass * ((1 - none) / mass.sum())
        return self.size * np.append(0.0, x), np.append(none, mass)

    @property
    def _shape(self) -> float:
        """The number of spikes that occur while a spike shrinks by the factor e."""
        return self.rate / -np.log(self._left)

    @property
    def _left(self) -> float:
        """The decay, limited to values with which spikes die out."""
        return min(max(self.decay, 1e-300), 1 - 1e-6)


LARGEST, LEAST = 16.0, 2e-3  # nodes of spikes above 0, as `REACH` of spikes, and in mean sizes


def spike_nodes(spikes: Spikes, count: int) -> np.ndarray:
    """Zero, and about `count` nodes above it with a constant ratio. If possible, the decay of a day
    is a power of this ratio, so that without a new spike every node moves to another node.
    """
    largest = LARGEST / (1 - spikes.size)
    log_ratio = np.log(LEAST / largest) / (count - 2)
    log_decay = np.log(max(spikes.decay, 1e-300))
    if a_day := round(log_decay / log_ratio):
        log_ratio = log_decay / a_day
    steps = np.arange(int(np.log(LEAST / largest) / log_ratio) + 2)
    return np.append(0.0, spikes.size * largest * np.exp(log_ratio * steps[::-1]))


def spike_weights(spikes: Spikes, nodes: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The weights [start, nodes] of the expectation a day later; or on the first date, if `start`
    is the valuation date."""
    points, probabilities = spikes.quadrature()
    from scipy.interpolate import CubicSpline  # late: few cases need it, and it loads slowly

    spline = CubicSpline(nodes, np.eye(len(nodes)))
    reached = spikes.decay * nodes[:, None] + points
    values = spline(np.clip(reached, 0.0, nodes[-1]))
    day = np.einsum("k,nkm->nm", probabilities, values)
    if len(start) > 1:
        return day
    weights = np.eye(len(nodes))[:1]
    for _ in range(spikes.before):
        weights = weights @ day
    return weights
