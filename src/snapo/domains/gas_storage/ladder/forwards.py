"""The forward curve on paths of Gaussian price factors.

    F(t, T) = F(T) exp(s(T) D f(t) - s(T)' D C(t) D' s(T) / 2)

with the decays D from t to T, and the covariance C(t) of the factors. This is the expected spot
price. For shifted prices it is the curve of F + shift; for normal prices the curve is F(T) + s(T) D
f(t).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..bounds.regression import product
from ..prices.process import GaussianFactors


@dataclass(frozen=True, eq=False)
class PathCurves:
    """Forward prices on paths, from today's curve `forward` [T + 1] and the factors `states` [T +
    1, F, N]."""

    factors: GaussianFactors
    forward: np.ndarray
    states: np.ndarray

    def __call__(self, t: int) -> np.ndarray:
        """[T + 1 - t, N] the prices of step t and all later steps, as seen on step t; for -1,
        today's prices [T + 1, N]."""
        if t < 0:
            return np.repeat(self.forward[:, None], self.states.shape[2], axis=1)
        loading, variance = self.loadings(t)
        return self._prices(t, product(loading, self.states[t]), variance)

    def loadings(self, t: int) -> tuple[np.ndarray, np.ndarray]:
        """[T + 1 - t, F] the loadings of later prices on the factors of step t, and [T + 1 - t] the
        variance of ln price that these factors cause."""
        decay = self.factors.decay[t:].copy()
        decay[0] = 1.0
        loading = self.factors.loading[t:] * np.cumprod(decay, axis=0)
        return loading, np.einsum("di,ij,dj->d", loading, self._covariance[t], loading)

    @property
    def spots(self) -> np.ndarray:
        """[T + 1, N] the price of each step, as seen on that step."""
        loading = self.factors.loading
        variance = np.einsum("di,dij,dj->d", loading, self._covariance, loading)
        return self._prices(0, np.einsum("di,din->dn", loading, self.states), variance)

    def _prices(self, t: int, moved: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """[T + 1 - t, N] the prices from step t on, each moved by factors with this variance."""
        noise = self.factors.noise(moved, variance[:, None])
        return self.factors.spot(self.forward[t:, None], noise)

    @cached_property
    def _covariance(self) -> np.ndarray:
        """[T + 1, F, F] the covariance of the factors on each step."""
        rows, now = [], np.zeros((self.factors.decay.shape[1],) * 2)
        for decay, shock in zip(self.factors.decay, self.factors.shock):
            now = np.outer(decay, decay) * now + shock @ shock.T
            rows.append(now)
        return np.array(rows)


def drawn_states(factors: GaussianFactors, paths: int, seed: int) -> np.ndarray:
    """[T + 1, F, N] the factors on random paths, in antithetic pairs."""
    random = np.random.default_rng(seed)
    size = factors.decay.shape[1]
    now, rows = np.zeros((size, paths)), []
    for decay, shock in zip(factors.decay, factors.shock):
        half = random.standard_normal((size, (paths + 1) // 2))
        noise = np.concatenate([half, -half], axis=1)[:, :paths]
        now = decay[:, None] * now + shock @ noise
        rows.append(now)
    return np.array(rows)
