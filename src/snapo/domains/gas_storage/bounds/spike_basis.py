"""Functions of Gaussian factors and spikes: all products of a function of the factors and a
function of the spikes.

The functions of spikes y are exponentials exp(k y), because decaying spikes raise the prices of the
next days by such factors. Their expectation has a formula: E[exp(k y(t + 1)) | y(t)] = E[exp(k J)]
exp(k decay y(t)). Factors and spikes are independent. A regression on the products is therefore the
Kronecker product of a regression on the functions of the factors and one on the functions of the
spikes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..prices.process import GaussianFactors
from ..prices.spikes import Spikes
from .basis import PolynomialBasis

# Exponents of the functions, the constant first: prices that are lifted, and, in parts of the mean
# size, values that no longer rise with a spike.
RISING, LEVEL = (0.0, 1.0, 0.6), (-0.5, -1.5, -5.0, -15.0)
COUNT = len(RISING) + len(LEVEL)
NODES, LARGEST = 16, 12.0  # of the regression: how many, and the largest in mean sizes
RARE = 0.05  # least weight of the nodes above 0, of that at 0


@dataclass(frozen=True, eq=False)
class SpikeBasis:
    """Products of the functions of `inner`, of the factors, and of exponentials of the spikes.

    It has the members of a `PolynomialBasis` that are needed to evaluate values. Coordinates are
    the factors, then y. The pair (i, j) is the function with the number i n + j, where n is the
    number of exponentials.
    """

    inner: PolynomialBasis
    spikes: Spikes

    @property
    def exponents(self) -> np.ndarray:
        """The exponents of the functions of the spikes."""
        return np.append(RISING, np.array(LEVEL) / self.spikes.size)

    @property
    def of(self) -> GaussianFactors:
        """The Gaussian factors, with their spikes."""
        return self.inner.of

    @property
    def selected(self) -> tuple[int, ...]:
        """The indices of the factors in the polynomials."""
        return self.inner.selected

    @property
    def size(self) -> int:
        """K, the number of functions."""
        return self.inner.size * COUNT

    @property
    def plain(self) -> int:
        """The number of functions without hinges."""
        return self.inner.plain * COUNT

    @property
    def parts(self) -> np.ndarray:
        """The array [K]; see `PolynomialBasis.parts`."""
        return np.repeat(self.inner.parts, COUNT)

    @property
    def constant(self) -> int:
        """The position of the constant function 1 among the functions without hinges."""
        return self.inner.constant * COUNT

    @cached_property
    def first(self) -> np.ndarray:
        """[K] expectations on the valuation date of the functions on the first day."""
        return np.kron(self.inner.first, self.spikes.first_moment(self.exponents))

    @cached_property
    def plain_first(self) -> np.ndarray:
        """The same expectations of the functions without hinges."""
        return np.kron(self.inner.plain_first, self.spikes.first_moment(self.exponents))

    def increments(self, states: np.ndarray) -> np.ndarray:
        """See `PolynomialBasis.increments`; `states` [T + 1, F + 1, paths]."""
        factors, y = states[:, :-1], states[:, -1:]
        result = _products(self.inner.functions(factors), np.exp(self.exponents[:, None] * y))
        moments, left = (
            self.spikes.moment(self.exponents)[:, None],
            self.spikes.decay * self.exponents,
        )
        ahead = moments * np.exp(left[:, None] * y[:-1])
        result[1:] -= _products(self.inner.expected(factors[:-1]), ahead)
        result[0] -= self.first[:, None]
        return result

    def linear(self) -> tuple[np.ndarray, ...]:
        """The arrays of `PolynomialBasis.linear`; then [T + 1, n] the exponents of the functions,
        and the exponents of their expectation a day before."""
        rows = np.ones((len(self.of.decay), 1))
        return (
            *self.inner.linear(),
            rows * self.exponents,
            rows * self.exponents * self.spikes.decay,
        )

    def expected_coefficients(self, after: np.ndarray) -> np.ndarray:
        """See `PolynomialBasis.expected_coefficients`; the result is for the exponentials on the
        day before."""
        split = after.reshape(*after.shape[:2], -1, COUNT)
        parts = [self.inner.expected_coefficients(split[..., j]) for j in range(COUNT)]
        return (np.stack(parts, axis=-1) * self.spikes.moment(self.exponents)).reshape(after.shape)

    def key(self) -> tuple:
        """A key that is equal for bases with the same functions of the same factors and spikes."""
        return *self.inner.key(), *self.spikes[:-1], self.spikes.compensator.tobytes()

    @cached_property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """The sizes of spikes at which values are fitted, and their weights."""
        nodes = self.spikes.size * LARGEST * (np.arange(NODES) / (NODES - 1)) ** 2
        weights = np.gradient(nodes) / self.spikes.size * np.exp(-nodes / self.spikes.size)
        often = max(self.spikes.rate / max(-np.log(self.spikes.decay), 1e-9), RARE)
        weights[1:] *= min(often, 1.0)
        weights[0] = 1.0
        return nodes, weights

    @cached_property
    def regression(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three arrays. The first [n, nodes] maps values at the nodes to coefficients; the second
        [n, nodes] has the expectations, at the nodes, of the functions on the next day; the third
        [n, n] has the coefficients that fit these expectations best."""
        nodes, weights = self.nodes
        functions = np.exp(self.exponents[:, None] * nodes)
        ahead = np.exp(self.spikes.decay * self.exponents[:, None] * nodes)
        ahead *= self.spikes.moment(self.exponents)[:, None]
        fit = np.linalg.pinv(functions.T * np.sqrt(weights)[:, None]) * np.sqrt(weights)
        return fit, ahead, ahead @ fit.T


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """[days, K n, paths] of functions [days, K, paths] and [days, n, paths]."""
    days, _, paths = left.shape
    return (left[:, :, None] * right[:, None]).reshape(days, -1, paths)
