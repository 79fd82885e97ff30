"""The regression of values of a store on a basis: the part that does not depend on prices.

Nodes, functions and normal equations follow from the price factors only, and those of the latest
factors are cached.
"""

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from ..prices.process import GaussianFactors
from .basis import REACH, PolynomialBasis, gaussian_basis
from .spike_basis import COUNT, SpikeBasis

MAXIMUM = 1 << 18  # multiplications; OpenBLAS takes one thread below


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """left [n, k] @ right [k, m], computed for some columns at a time."""
    wide = max(MAXIMUM // max(left.size, 1), 1)
    if right.shape[1] <= wide:
        return left @ right
    result = np.empty((len(left), right.shape[1]))
    for first in range(0, right.shape[1], wide):
        block = slice(first, first + wide)
        np.matmul(left, right[:, block], out=result[:, block])
    return result


T = TypeVar("T")


class Recent(Generic[T]):
    """A cache of the results of the last few different calls, safe between threads. A page that
    moves a curve, or a table of sensitivities that moves one input after another, needs the same
    results repeatedly.
    """

    def __init__(self, maximum: int):
        self._most = maximum
        self._known: tuple[tuple[Hashable, T], ...] = ()

    def of(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result for this key; `make` computes it if it is not among the last results."""
        others = tuple(item for item in self._known if item[0] != key)
        results = next((result for available, result in self._known if available == key), None)
        if results is None:
            results = make()
        self._known = ((key, results), *others)[: self._most]
        return results

    def clear(self) -> None:
        """Removes all results."""
        self._known = ()


ALONE, FAST = 121, 37  # uniform nodes of the fast factor, to REACH standard deviations
COUNTS = {
    1: (),
    2: (6,),
    3: (6, 5),
}  # Gauss-Hermite nodes of the others; more of them: Sobol points
POINTS = 1024
LEVELS = 2  # nodes of the factor in the exponential
RIDGE = 1e-11  # of the regression, against the sum of squares of the functions
MAX_KEPT = 128 << 20  # bytes; of longer contracts the last day is kept
LAST = 2  # factors: those of the case, and others that a sensitivity moves to


class RegressionDay(NamedTuple):
    """One day, or the end date. K functions, n of which are not hinges, on Q nodes.

    - `fit` [K, Q]: the coefficients of values [m, Q] are values @ fit.T.
    - `ahead` [K, Q]: the expected functions of the next date (zero on the end date).
    - `plain` [K, n]: the coefficients of the best approximation of each function by functions
      without hinges.
    - `drift` [K, n]: the same coefficients for `ahead`.
    """

    fit: np.ndarray
    ahead: np.ndarray
    plain: np.ndarray
    drift: np.ndarray


class Regression:
    """The regressions of all days of a basis. `y` [kept, Q], `level` [Q], `weight` [Q]: see
    `states_of`."""

    def __init__(self, basis: PolynomialBasis):
        self.basis = basis
        self.y, self.level, self.weight = states_of(basis)
        self._same = basis.same_days()
        self._days: dict[int, RegressionDay] = {}
        self._noises: dict[int, np.ndarray] = {}
        self._different = np.unique(self._same)
        numbers = 2 * basis.size * len(self._different) + len(self._same)
        self._keeps = numbers * self.level.size * 8 <= MAX_KEPT
        self._block = max(MAXIMUM // (basis.size * self.level.size), 1)  # days made together

    def day(self, t: int) -> RegressionDay:
        """The regression on day t."""
        same = int(self._same[t])
        if same not in self._days:
            if not self._keeps:
                self._days = {}  # all but the last: each is asked for several times in turn
            block = int(np.searchsorted(self._different, same)) // self._block * self._block
            days = self._different[block : block + self._block]
            self._days |= zip(days.tolist(), self._made(days), strict=True)
        return self._days[same]

    def fitted(self, t: int, values: np.ndarray) -> np.ndarray:
        """[m, K] coefficients of values [m, Q] on day t."""
        return product(self.day(t).fit, values.T).T

    def expected(self, t: int, coefficients: np.ndarray) -> np.ndarray:
        """[m, Q] expectations on day t of the functions [m, K] of the next date."""
        return product(coefficients, self.day(t).ahead)

    def plain(self, t: int) -> np.ndarray:
        """The array [K, n] of the day; see `RegressionDay`."""
        return self.day(t).plain

    def drift(self, t: int) -> np.ndarray:
        """The array [K, n] of the day; see `RegressionDay`."""
        return self.day(t).drift

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """Spot prices [Q] on day t, of mean `forward`."""
        return self.basis.of.spot(forward, self._noise(t))

    def _noise(self, t: int) -> np.ndarray:
        noise = self._noises.get(t)
        if noise is None:
            of, basis = self.basis.of, self.basis
            log = of.loading[t][list(basis.selected)] @ basis.back(t) @ self.y
            log += basis.level_deviation(t) * self.level * bool(basis.common)
            noise = of.noise(log, of.variance[t])
            if self._keeps:
                self._noises[t] = noise
        return noise

    @cached_property
    def _polynomials(self) -> np.ndarray:
        return self.basis.polynomials(self.y[None])  # the same points every day

    def _made(self, days: np.ndarray) -> list[RegressionDay]:
        basis, level, y = self.basis, self.level, self.y[None]
        bare = basis.of_whitened(y, days, self._polynomials)
        here = scaled(basis, days, bare, level)
        plain = scaled(basis, days, bare[:, : len(basis.powers)], level)
        before = days[days + 1 < len(basis.of.decay)]  # the end date has no next date
        ahead = np.zeros_like(here)
        later = basis.ahead_of_whitened(y, before, self._polynomials)
        ahead[: len(before)] = scaled(basis, before, later, level)
        weighed, bare = here * self.weight, plain * self.weight
        smooth = _products(bare, plain)
        fit = _solved(_products(weighed, here), weighed)
        same, drift = (_solved(smooth, _products(bare, part)) for part in (here, ahead))
        return [RegressionDay(fit[i], ahead[i], same[i].T, drift[i].T) for i in range(len(days))]


class SpikeRegression:
    """The regression for a basis with spikes; its nodes are the products of the nodes of the
    factors and the nodes of the spikes."""

    def __init__(self, basis: SpikeBasis):
        self.basis, self.inner = basis, regression(basis.inner)

    def fitted(self, t: int, values: np.ndarray) -> np.ndarray:
        """[m, K] coefficients of values [m, Q] on day t."""
        return _both(values, self.inner.day(t).fit.T, self.basis.regression[0].T)

    def expected(self, t: int, coefficients: np.ndarray) -> np.ndarray:
        """[m, Q] expectations on day t of the functions [m, K] of the next date."""
        return _both(coefficients, self.inner.day(t).ahead, self.basis.regression[1])

    def plain(self, t: int) -> np.ndarray:
        """The array [K, n] of the day; see `RegressionDay`."""
        return np.kron(self.inner.plain(t), np.eye(COUNT))

    def drift(self, t: int) -> np.ndarray:
        """The array [K, n] of the day; see `RegressionDay`."""
        return np.kron(self.inner.drift(t), self.basis.regression[2])

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """Spot prices [Q] on day t, of mean `forward`."""
        spikes = np.exp(self.basis.nodes[0] - self.basis.spikes.compensator[t])
        return np.kron(self.inner.spot(t, forward), spikes)


def _both(rows: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Rows [m, k n] times the Kronecker product of `left` [k, …] and `right` [n, …]."""
    count, k, n = len(rows), len(left), len(right)
    part = product(right.T, rows.reshape(count * k, n).T)  # [… , count k]
    part = part.reshape(-1, count, k).transpose(2, 1, 0).reshape(k, -1)
    return (
        product(left.T, part).reshape(-1, count, right.shape[1]).swapaxes(0, 1).reshape(count, -1)
    )


AnyBasis = PolynomialBasis | SpikeBasis
AnyRegression = Regression | SpikeRegression
_last: Recent[Regression] = Recent(LAST)


def basis_of(of: GaussianFactors, priced: bool) -> AnyBasis:
    """The functions for these factors and their spikes; `priced`: whether the end date has a
    price."""
    inner = gaussian_basis(of, priced)
    return inner if of.spikes is None else SpikeBasis(inner, of.spikes)


def regression_of(basis: AnyBasis) -> AnyRegression:
    """The regression of a basis."""
    return SpikeRegression(basis) if isinstance(basis, SpikeBasis) else regression(basis)


def regression(basis: PolynomialBasis) -> Regression:
    """The regression of a basis; the regressions of the last factors are cached."""
    of = basis.of
    key = *basis.key(), of.loading.tobytes(), of.variance.tobytes(), of.additive, of.shift
    return _last.of(key, lambda: Regression(basis))


def states_of(basis: PolynomialBasis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened factors [kept, Q], standardised ln g [Q], and weights of the regression [Q]."""
    levels = LEVELS if basis.common else 1
    selected = len(basis.selected)
    if selected not in COUNTS:
        from scipy.special import ndtri  # late: a case is checked without scipy
        from scipy.stats import qmc

        points = qmc.Sobol(selected + 1, rng=np.random.default_rng(0)).random(POINTS).T
        z = ndtri(np.clip(points, 2.0**-31, 1 - 2.0**-31))
        return z[:selected], z[selected] * bool(basis.common), np.ones(POINTS)
    fast = np.linspace(-REACH, REACH, ALONE if selected == 1 else FAST)
    grids = [(fast, np.exp(-(fast**2) / 2))]
    grids += [_gauss_hermite(count) for count in (*COUNTS[selected], levels)]
    axes = np.meshgrid(*(grid[0] for grid in grids), indexing="ij")
    mass = np.meshgrid(*(grid[1] for grid in grids), indexing="ij")
    z = np.stack([axis.ravel() for axis in axes])
    return z[:-1], z[-1], np.prod(mass, axis=0).ravel()


def _gauss_hermite(count: int) -> tuple[np.ndarray, np.ndarray]:
    points, weights = np.polynomial.hermite_e.hermegauss(count)
    return points, weights / weights.sum()


def scaled(
    basis: PolynomialBasis, days: np.ndarray, result: np.ndarray, level: np.ndarray
) -> np.ndarray:
    """[days, K, Q] the functions, from their parts without g."""
    if not basis.common:
        return result
    deviation = basis.level_deviation(days)[:, None, None]
    scale = np.exp(deviation * level - deviation**2 / 2)
    one = np.ones((len(days), 1, result.shape[-1]))
    return np.concatenate([scale * result, one], axis=1)


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """[days, k, m] the products of left [days, k, Q] and right [days, m, Q] transposed."""
    return np.array([product(a, b.T) for a, b in zip(left, right, strict=True)])


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """[days, K, …] the solution of weighted least squares with these normal equations; undetermined
    parts of it are small."""
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None]
    return np.linalg.solve(normal + ridge * np.eye(normal.shape[-1]), right)
