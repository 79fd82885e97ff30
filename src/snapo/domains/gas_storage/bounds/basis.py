"""Functions of Gaussian price factors whose conditional expectations are known in closed form.

The functions are products of normalised Hermite polynomials he_n = He_n / sqrt(n!) in whitened
factors y, and hinges (y - k)+ in the fast factor, where every decision leaves a kink. All are
multiplied by g, the exponential of the factors that move all prices in proportion (a martingale of
mean 1). If there is such an exponential, the constant is added as a function, since proportional
costs do not scale with g.

    Y(t + 1) = R Y(t) + noise,   E[he_a(Y(t + 1)) | Y(t)] = sum over |b| = |a| of M[a, b] he_b(Y(t))

with M = rho^a on the diagonal if the factors are independent (Mehler's formula); otherwise M
follows from the generating function exp(s.y - s.s / 2), whose expectation is the same function at
R' s. With mean m and deviation s of y(t + 1), E[(y(t + 1) - k)+] = s phi(d) + (m - k) Phi(d), d =
(m - k) / s.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from ..prices.process import GaussianFactors

DEGREES = {1: 6, 2: 4, 3: 4}  # total degree by number of factors; of more factors: 3
# Hinges, in standard deviations of the fast factor: many where it is the only one.
ALONE, FEW = np.arange(-3.0, 3.1, 0.25), np.arange(-1.75, 2.0, 0.5)
REACH = 4.0  # standard deviations of a factor beyond which nothing is fitted
NOTHING = 1e-14  # a variance below this is none
SAME = 13  # decimals of days that count as the same


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    """K functions of the price factors on the T days and the end date.

    - `of`: all factors; `selected`: indices of the factors in the polynomials, the fast factor
      first.
    - `common`: indices of the factors in the exponential, of which there may be none.
    - `powers`: [n, kept] degrees of the polynomials; K = n, or n + 1 with the constant.
    """

    of: GaussianFactors
    selected: tuple[int, ...]
    common: tuple[int, ...]
    powers: np.ndarray

    @property
    def size(self) -> int:
        return len(self.powers) + len(self.hinges) + bool(self.common)

    @property
    def plain(self) -> int:
        """The number of functions without hinges."""
        return len(self.powers) + bool(self.common)

    @property
    def parts(self) -> np.ndarray:
        """[K] the part of a penalty to which a function belongs: polynomials, hinges or the
        constant."""
        return np.repeat(range(3), [len(self.powers), len(self.hinges), bool(self.common)])

    @property
    def constant(self) -> int:
        """The position of the constant function 1 among the functions without hinges."""
        return (
            len(self.powers) if self.common else int(np.flatnonzero(_degree(self.powers) == 0)[0])
        )

    @property
    def plain_first(self) -> np.ndarray:
        """Expectations on the valuation date of the functions without hinges on the first day."""
        mean = (_degree(self.powers) == 0).astype(float)
        return np.append(mean, 1.0) if self.common else mean

    def functions(self, states: np.ndarray, first: int = 0) -> np.ndarray:
        """[days, K, paths] the functions on days first, first + 1 …, from the factors [days, F,
        paths]."""
        days = np.arange(first, first + len(states))
        result = self.of_whitened(self._whitened(states, days), days)
        return self._assemble(result, self._level(states, days))

    def expected(self, states: np.ndarray, first: int = 0) -> np.ndarray:
        """[days, K, paths] the conditional expectations of the functions a day later."""
        days = np.arange(first, first + len(states))
        ahead = self.ahead_of_whitened(self._whitened(states, days), days)
        return self._assemble(ahead, self._level(states, days))

    def increments(self, states: np.ndarray) -> np.ndarray:
        """[T + 1, K, paths] the functions minus their conditional expectations a day before.

        `states` [T + 1, F, paths]. The first row is relative to the valuation date.
        """
        functions = self.functions(states)
        functions[1:] -= self.expected(states[:-1])
        functions[0] -= self.first[:, None]
        return functions

    @property
    def hinges(self) -> np.ndarray:
        """[hinges] the positions of the hinges, in standard deviations of the fast factor."""
        return hinges(len(self.selected))

    @property
    def first(self) -> np.ndarray:
        """[K] expectations on the valuation date of the functions on the first day."""
        constant = np.all(self.powers == 0, axis=1).astype(float)
        hinges = _hinge_means(self.hinges, np.zeros(()), np.ones(())) * self._moving[0, 0]
        result = np.append(constant, hinges)
        return np.append(result, 1.0) if self.common else result

    def of_whitened(
        self, y: np.ndarray, days: np.ndarray, polynomials: np.ndarray | None = None
    ) -> np.ndarray:
        """[days, n + hinges, paths] the part of the functions without g, from whitened factors
        [days, kept, paths], or [1, kept, paths] if they are the same every day. A factor that does
        not vary on a day counts as zero, and functions of it are left out. `polynomials`: the
        polynomials of y, if they have been computed.
        """
        available = self.polynomials(y) if polynomials is None else polynomials
        plain = available * self._alive[days][:, :, None]
        hinges = np.maximum(y[:, :1] - self.hinges[:, None], 0.0) * self._moving[days, :1, None]
        return np.concatenate([plain, hinges], axis=1)

    def ahead_of_whitened(
        self, y: np.ndarray, days: np.ndarray, polynomials: np.ndarray | None = None
    ) -> np.ndarray:
        """[days, n + hinges, paths] the conditional expectations of the functions of `of_whitened`
        on the day after each of `days`; none of these days is the last date."""
        after = days + 1
        available = self.polynomials(y) if polynomials is None else polynomials
        now, moves = available * self._alive[days][:, :, None], self._moves[after]
        plain = moves * now if moves.shape[-1] == 1 else moves @ now
        row = self._turn[after][:, 0]
        deviation = np.sqrt(np.maximum(1 - np.sum(row**2, axis=1), NOTHING))
        mean = np.einsum("tj,tjp->tp", row, y)
        hinges = np.moveaxis(_hinge_means(self.hinges, mean, deviation[:, None]), 0, 1)
        return np.concatenate([plain, hinges * self._moving[after, :1, None]], axis=1)

    def _whitened(self, states: np.ndarray, days: np.ndarray) -> np.ndarray:
        return np.einsum("tij,tjp->tip", self._whiten[days], states[:, self.selected])

    def polynomials(self, y: np.ndarray) -> np.ndarray:
        """[..., n, paths] products of Hermite polynomials, from whitened factors."""
        maximum = self.powers.max(axis=0)
        tables = [_hermite(y[..., i, :], degree) for i, degree in enumerate(maximum)]
        polynomials = np.empty((*y.shape[:-2], len(self.powers), y.shape[-1]))
        for k, degrees in enumerate(self.powers):
            factors = [tables[i][d] for i, d in enumerate(degrees) if d]
            polynomials[..., k, :] = math.prod(factors[1:], start=factors[0]) if factors else 1.0
        return polynomials

    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three arrays [T + 1, kept, F], [T + 1, F] and [T + 1], with which y = first f and ln g =
        second f - third."""
        dates, size = self.of.decay.shape
        whiten, common = np.zeros((dates, len(self.selected), size)), np.zeros((dates, size))
        whiten[:, :, self.selected] = self._whiten
        common[:, self.common] = self._common_loading
        return whiten, common, self._level_variance / 2

    def expected_coefficients(self, after: np.ndarray) -> np.ndarray:
        """[T, levels, n] the coefficients of the expectation, a day before, of polynomials with
        coefficients [T, levels, n]. The coefficients are for the dates after the first date, and
        for functions that include the exponential; the coefficient of the constant, if there is
        one, is the last.
        """
        size, moves = len(self.powers), self._moves[1:]
        plain = after[:, :, :size]
        plain = plain * moves[:, None, :, 0] if moves.shape[-1] == 1 else plain @ moves
        plain = plain * self._alive[:-1, None, :]
        return np.concatenate([plain, after[:, :, size:]], axis=2)

    def same_days(self) -> np.ndarray:
        """[T + 1] the first date with the same functions, expectations and exponential.

        The standard deviation of a factor that reverts fast is soon constant: a year of hours has
        far fewer different dates than hours.
        """
        dates = len(self._turn)
        after = np.minimum(np.arange(dates) + 1, dates - 1)
        numbers = self._alive, self._moving, self._moving[after], self._turn[after]
        numbers += self._level_variance * bool(self.common), np.arange(dates) == dates - 1
        rows = np.hstack([np.reshape(x, (dates, -1)) for x in numbers])
        result = np.unique(rows.round(SAME), axis=0, return_index=True, return_inverse=True)
        return result[1][result[2].ravel()]

    def key(self) -> tuple:
        """A key that is equal for bases with the same functions of the same factors."""
        numbers = self.of.transition, self.of.shock, self._common_loading
        return self.selected, self.common, *(x.tobytes() for x in numbers), self.of.decay.shape

    def back(self, t: int) -> np.ndarray:
        """[kept, kept] the factors of day t per unit of the whitened factors."""
        return self._cholesky[t]

    def level_deviation(self, days: np.ndarray | int) -> np.ndarray:
        """The standard deviation of ln g on these days."""
        return np.sqrt(self._level_variance[days])

    def _level(self, states, days) -> np.ndarray | None:
        if not self.common:
            return None
        log = np.einsum("i,tip->tp", self._common_loading, states[:, self.common])
        return np.exp(log - self._level_variance[days, None] / 2)

    def _assemble(self, assemble, level) -> np.ndarray:
        if level is None:
            return assemble
        one = np.ones((*level.shape[:-1], 1, level.shape[-1]))
        return np.concatenate([level[..., None, :] * assemble, one], axis=-2)

    @property
    def _common_loading(self) -> np.ndarray:
        return self.of.loading[0, list(self.common)]

    @cached_property
    def _covariance(self) -> np.ndarray:
        return self.of.covariance

    @cached_property
    def _level_variance(self) -> np.ndarray:
        part = self._covariance[:, self.common][:, :, self.common]
        return np.einsum("i,tij,j->t", self._common_loading, part, self._common_loading)

    @cached_property
    def _moving(self) -> np.ndarray:
        """[T + 1, kept] whether the factor varies on the day."""
        return np.diagonal(self._covariance, axis1=1, axis2=2)[:, self.selected] > NOTHING

    @cached_property
    def _alive(self) -> np.ndarray:
        return np.all(self._moving[:, None, :] | (self.powers == 0)[None], axis=2)

    @cached_property
    def _cholesky(self) -> np.ndarray:
        part = self._covariance[:, self.selected][:, :, self.selected]
        both = self._moving[:, :, None] & self._moving[:, None, :]
        still = ~self._moving[:, :, None] & np.eye(len(self.selected), dtype=bool)
        root = np.linalg.cholesky(np.where(both, part, 0.0) + still)
        return np.where(both, root, 0.0)

    @cached_property
    def _whiten(self) -> np.ndarray:
        still = ~self._moving[:, :, None] & np.eye(len(self.selected), dtype=bool)
        both = self._moving[:, :, None] & self._moving[:, None, :]
        return np.where(both, np.linalg.inv(self._cholesky + still), 0.0)

    @cached_property
    def _turn(self) -> np.ndarray:
        """[T + 1, kept, kept] the matrix R of the step to each date."""
        before = np.concatenate([np.zeros_like(self._cholesky[:1]), self._cholesky[:-1]])
        moves = self.of.transition[:, self.selected][:, :, self.selected]
        return self._whiten @ moves @ before

    @cached_property
    def _moves(self) -> np.ndarray:
        """[T + 1, n, 1] factors, or [T + 1, n, n] matrices M, of the step to each date."""
        turn = self._turn
        if np.all(np.abs(turn * (1 - np.eye(len(self.selected)))) < 1e-12):
            local = np.diagonal(turn, axis1=1, axis2=2)
            return np.prod(local[:, None, :] ** self.powers[None], axis=2)[:, :, None]
        return np.array([_mehler(item, self.powers) for item in turn])


def gaussian_basis(of: GaussianFactors, priced: bool) -> PolynomialBasis:
    """The functions for these factors; `priced`: whether the end date has a price."""
    if of.index is not None:
        every = tuple(range(of.decay.shape[1]))
        return PolynomialBasis(of, every, (), powers(len(every)))
    loading = of.loading if priced else of.loading[:-1]
    increments = np.max(np.abs(of.shock @ np.swapaxes(of.shock, 1, 2)), axis=0)
    alone = np.count_nonzero(increments > 1e-12 * increments.max(), axis=1) <= 1
    same = np.ptp(loading, axis=0) <= 1e-12 * np.abs(loading).max()
    common = alone & same & np.all(of.decay == 1, axis=0) & of.proportional
    defaulted = (np.abs(loading).max(axis=0) == 0) | (np.diagonal(increments) == 0)
    speed = np.argsort(of.decay.mean(axis=0), kind="stable")
    selected = tuple(int(i) for i in speed if not common[i] and not defaulted[i]) or (
        int(speed[0]),
    )
    common = tuple(int(i) for i in speed if common[i] and not defaulted[i] and i not in selected)
    return PolynomialBasis(of, selected, common, powers(len(selected)))


def hinges(count: int) -> np.ndarray:
    """[hinges] the positions of the hinges for this number of factors, in standard deviations of
    the fast factor."""
    return ALONE if count == 1 else FEW


def _degree(powers: np.ndarray) -> np.ndarray:
    """[n] the total degrees."""
    return powers.sum(axis=1)


def powers(count: int) -> np.ndarray:
    """[n, count] degrees of all products up to a total degree, all of which `_mehler` needs."""
    total = DEGREES.get(count, 3)
    every = product(range(total + 1), repeat=count)
    return np.array([item for item in every if sum(item) <= total])


def _hermite(y: np.ndarray, degree: int) -> list[np.ndarray]:
    """Normalised polynomials up to a degree: sqrt(n + 1) he_(n+1) = y he_n - sqrt(n) he_(n-1)."""
    hermite = [np.ones_like(y), y]
    for n in range(1, degree):
        hermite.append((y * hermite[n] - math.sqrt(n) * hermite[n - 1]) / math.sqrt(n + 1))
    return hermite


def _hinge_means(hinges: np.ndarray, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """[hinges, ...] expectations of (y - k)+, y normal."""
    from scipy.special import ndtr  # late: a case is checked without it

    above = mean - hinges.reshape(-1, *[1] * mean.ndim)
    d = above / deviation
    return deviation * np.exp(-(d**2) / 2) / math.sqrt(2 * math.pi) + above * ndtr(d)


def _mehler(turn: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """[n, n] expectations of the polynomials after y' = turn y + noise, y and y' both standard.

    For all polynomials up to a total degree. The coefficient of s^a in prod_j ((turn' s)_j)^b_j.
    """
    position = {tuple(map(int, item)): k for k, item in enumerate(powers)}
    root = np.sqrt([math.prod(math.factorial(d) for d in entry) for entry in position])
    matrix = np.zeros((len(powers), len(powers)))
    for b, column in position.items():
        terms = {(0,) * len(b): 1.0}
        for j, power in enumerate(b):
            for _ in range(power):
                terms = _times(terms, turn[:, j])
        for a, coefficient in terms.items():
            matrix[position[a], column] = coefficient * root[position[a]] / root[column]
    return matrix


def _times(terms: dict[tuple[int, ...], float], line: np.ndarray) -> dict[tuple[int, ...], float]:
    """A polynomial in s times the linear form line.s."""
    coefficients: dict[tuple[int, ...], float] = {}
    for powers, coefficient in terms.items():
        for i, slope in enumerate(line):
            if slope:
                raised = (*powers[:i], powers[i] + 1, *powers[i + 1 :])
                coefficients[raised] = coefficients.get(raised, 0.0) + coefficient * slope
    return coefficients
