"""The law of the spikes of a price, as dynamic programs read it: y(t + 1) = decay y(t) + J.

J >= 0 is what spikes of a day leave at its end, independent of the past: at most one of exponential
size ("Bernoulli"), or what is left of a compound Poisson process. Everything here is plain NumPy.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import hyp1f1

REACH = 30.0  # of the exponent of the density times exp(J), up to which that is integrated
PANELS = 48  # of the quadrature, with 4 nodes each


class Spikes(NamedTuple):
    """Spikes of ln S: log-price + y - compensator.

    - `decay`: what is left of a spike after a day; `size`: the mean of a spike.
    - `rate`: spikes a day; `poisson`: whether several may come, and die out within the day.
    - `before`: days from the valuation date, when there are none, to the first date.
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
            return ((1 - self.decay * x) / (1 - x)) ** self._shape
        chance = -np.expm1(-self.rate)
        return 1 - chance + chance / (1 - x)

    def first_moment(self, exponent: np.ndarray) -> np.ndarray:
        """E[exp(exponent y)] on the first date."""
        result = np.ones_like(exponent)
        for day in range(self.before):
            result = result * self.moment(exponent * self.decay**day)
        return result

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and probabilities of J, the first of which is no spike."""
        nodes, weights = np.polynomial.legendre.leggauss(4)
        edges = REACH / (1 - self.size) * (np.arange(PANELS + 1) / PANELS) ** 2
        half = np.diff(edges) / 2
        x = (edges[:-1, None] + half[:, None] * (nodes + 1)).ravel()
        density = np.exp(-x)  # in mean sizes
        none = np.exp(-self.rate)
        if self.poisson:
            # A negative binomial number of exponentials: Kummer's form of the mixture of gammas.
            shape, left = self._shape, max(self.decay, 1e-300)
            z = x * (1 - self.decay) / left
            density = density * hyp1f1(1 - shape, 2, -z) * shape * (1 - self.decay) / left
        mass = density * (half[:, None] * weights).ravel()
        mass = mass * ((1 - none) / mass.sum())
        return self.size * np.append(0.0, x), np.append(none, mass)

    @property
    def _shape(self) -> float:
        """Spikes that come while one dies out by the factor e."""
        return self.rate / max(-np.log(self.decay), 1e-9)
