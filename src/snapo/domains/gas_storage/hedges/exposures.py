"""Exposures along paths: the remaining pathwise exposure, regressed on the state of the day.

Let q(d) be the volume sold on day d of a path at its spot price S(d), D(d) the discount factor of
its payment, F_t(d) the forward price on day t, and b the days of a product. For optimal decisions,
the value changes with the price of the product as if the decisions were fixed (envelope theorem):

    volume of b on day t = E_t[sum over b of D(d) q(d) S(d)] / sum over b of D(d) F_t(d)

for prices that are proportional to the curve. For shifted prices, S + shift and F + shift replace S
and F; for normal prices, both are 1. The conditional expectation is a least-squares fit on one set
of paths, after the flow of the day, with polynomials in the level and the price factors; no nested
simulation is needed.

The part that the mean volumes of all paths cause is computed exactly and not fitted.

The exposure to factor k is the same sum, weighted with the sensitivity of ln F_{t+1}(d) to this
factor.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.polynomial.hermite_e import hermevander
from numpy.polynomial.legendre import legvander

from snapo.lanes.machine.threads import cores

from ..bounds.basis import gaussian_basis
from ..ladder.forwards import PathCurves
from ..prices.process import GaussianFactors

BLOCK = 1024  # paths at once
DEGREES = {2: 5, 3: 4}  # total degree by number of variables, the level among them; of more: 3
REACH = 4.0  # standard deviations of a factor beyond which a fit is constant
SMALLEST = 1e-9  # eigenvalue of the functions' moments, against the largest, that is used

Days = tuple[int, int]  # the first, and the one after the last


@dataclass(frozen=True, eq=False)
class StorePaths:
    """A contract on paths, operated by any rule.

    - `factors`: the factors of its prices, exact and without spikes; `forward` [T + 1]: today's
      curve, with the price of the end date last; `discount` [T + 1]: the discount factor of the
      payment for the gas of each of these dates.
    - `states` [T + 1, F, N]: the factors; `levels` [T + 1, N]: levels at the start of each day and
      at the end; `sold` [T + 1, N]: volume sold at the spot price, negative if bought.
    - `money` [N]: the present value of all payments.
    """

    factors: GaussianFactors
    forward: np.ndarray
    discount: np.ndarray
    states: np.ndarray
    levels: np.ndarray
    sold: np.ndarray
    money: np.ndarray

    @property
    def count(self) -> int:
        return self.states.shape[2]

    @property
    def horizon(self) -> int:
        return len(self.forward) - 1

    def some(self, first: int) -> "StorePaths":
        """A block of the paths."""
        last = slice(first, first + BLOCK)
        states, levels = self.states[:, :, last], self.levels[:, last]
        rest = self.sold[:, last], self.money[last]
        return StorePaths(self.factors, self.forward, self.discount, states, levels, *rest)

    @property
    def blocks(self) -> "list[StorePaths]":
        return [self.some(first) for first in range(0, self.count, BLOCK)]

    @cached_property
    def curves(self) -> PathCurves:
        return PathCurves(self.factors, self.forward, self.states)

    def ahead(self, t: int) -> np.ndarray:
        """[T - t, N] the forward prices of the dates after step t, as seen on that step; for -1,
        today's forward prices."""
        return self.curves(t)[1:] if t >= 0 else self.curves(t)

    def moving(self, prices: np.ndarray) -> np.ndarray:
        """The part of prices that noise multiplies: prices + shift, or 1 for normal prices."""
        if self.factors.additive:
            return np.ones_like(prices)
        return prices + self.factors.shift

    def paid(self, t: int, prices: np.ndarray) -> np.ndarray:
        """The prices [n, N] of dates from t on, discounted."""
        return self.discount[t:, None] * prices

    @cached_property
    def exposed(self) -> np.ndarray:
        """[T + 1, N] the pathwise exposure to the price of each date."""
        return self.sold * self.paid(0, self.moving(self.curves.spots))

    @cached_property
    def volumes(self) -> np.ndarray:
        """[T + 1] today's deltas by day, as volumes: the mean exposure divided by today's price."""
        return self.exposed.mean(axis=1) / (self.discount * self.moving(self.forward))


@dataclass(frozen=True, eq=False)
class StateFunctions:
    """Polynomials in the level after the flow of a day and the factors of the day.

    - `low`, `high` [T]: the range of that level on the paths of the fit.
    """

    factors: GaussianFactors
    low: np.ndarray
    high: np.ndarray

    @cached_property
    def _linear(self):
        return gaussian_basis(self.factors, priced=True).linear()

    @cached_property
    def _powers(self) -> np.ndarray:
        """[K, 1 + selected] the degrees of the polynomials."""
        count = 1 + self._linear[0].shape[1]
        total = DEGREES.get(count, 3)
        every = product(range(total + 1), repeat=count)
        return np.array([item for item in every if sum(item) <= total])

    def __call__(self, t: int, level: np.ndarray, states: np.ndarray) -> np.ndarray:
        """[K, N] the functions, from the level [N] after step t and the factors [F, N] of the
        step."""
        first, common, variance = self._linear
        middle, half = (self.high[t] + self.low[t]) / 2, (self.high[t] - self.low[t]) / 2
        share = np.clip((level - middle) / half, -1, 1) if half > 0 else 0 * level
        selected = np.clip(first[t] @ states, -REACH, REACH)
        degree = int(self._powers.max())
        sizes = [np.sqrt(2 * np.arange(degree + 1) + 1)] + len(selected) * [_hermite_sizes(degree)]
        tables = [legvander(share, degree), *(hermevander(row, degree) for row in selected)]
        tables = [size[:, None] * table.T for size, table in zip(sizes, tables, strict=True)]
        columns = np.ones((len(self._powers), level.size))
        for k, powers in enumerate(self._powers):
            for table, power in zip(tables, powers):
                if power:
                    columns[k] *= table[power]
        if not np.any(variance):
            return columns
        deviation = np.sqrt(2 * variance[t]) or 1.0
        parallel = np.clip(common[t] @ states / deviation, -REACH, REACH)
        return np.concatenate([columns, columns[self._powers.sum(axis=1) <= 1] * parallel])


@dataclass(frozen=True, eq=False)
class FittedExposures:
    """The fit of each step of `products`.

    - `volumes` [T + 1]: today's deltas by day; `products`: {step: the days of the products held
      from that step on}.
    - `coefficients`: {step from 0 on: [K, products + F] the coefficients of the functions}.
    """

    functions: StateFunctions
    volumes: np.ndarray
    products: Mapping[int, Sequence[Days]]
    coefficients: Mapping[int, np.ndarray]

    @classmethod
    def of(cls, paths: StorePaths, products: Mapping[int, Sequence[Days]]) -> "FittedExposures":
        """The fit on these paths."""
        after = paths.levels[1:]
        functions = StateFunctions(paths.factors, after.min(axis=1), after.max(axis=1))
        volumes = paths.volumes

        def moments(part: StorePaths) -> list[tuple[np.ndarray, np.ndarray]]:
            return [
                (design @ design.T, design @ targets.T)
                for design, targets in _targets(part, volumes, functions, products)
            ]

        with ThreadPoolExecutor(cores()) as pool:
            parts = list(pool.map(moments, paths.blocks))
        solved = {}
        for t, step in zip(_steps(products, paths.horizon), zip(*parts, strict=True), strict=True):
            square, right = (sum(x) for x in zip(*step, strict=True))
            solved[t] = _solved(np.asarray(square), np.asarray(right))
        return cls(functions, volumes, products, solved)

    def at(self, t: int, part: StorePaths, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For other paths: the volumes per day [products, N] that are sold forward after the flow
        of step t, and the discounted exposures [F, N] to the shocks of the factors. `moving` [T -
        t, N]: the part of the discounted prices of the later dates that noise moves.
        """
        blocks, fixed = self.products[t], moving * self.volumes[t + 1 :, None]
        fit = np.zeros((len(blocks) + len(part.factors.decay[0]), part.count))
        if t >= 0:
            design = self.functions(t, part.levels[t + 1], part.states[t])
            fit += self.coefficients[t].T @ design
        for row, (first, after) in zip(fit, blocks):
            days = slice(first - t - 1, after - t - 1)
            row += fixed[days].sum(axis=0) / moving[days].sum(axis=0)
        factors = fit[len(blocks) :] * moving.sum(axis=0)
        return fit[: len(blocks)], factors + sensitivities(part.factors, t).T @ fixed


def _steps(products: Mapping[int, Sequence[Days]], horizon: int) -> list[int]:
    """The steps with a fit, the last step first; before step 0 all paths are in one state."""
    return [t for t in reversed(range(horizon)) if t in products]


def _targets(part: StorePaths, volumes: np.ndarray, functions: StateFunctions, blocks):
    """The functions and the targets of each step of `blocks`, the last step first."""
    factors, horizon = part.factors, part.horizon
    fixed = part.paid(0, part.moving(part.curves.spots)) * volumes[:, None]
    rest = part.exposed - fixed
    summed = np.concatenate([np.zeros_like(rest[:1]), np.cumsum(rest, axis=0)])
    weighted = np.zeros((factors.decay.shape[1], part.count))
    for t in reversed(range(horizon)):
        decay = factors.decay[t + 2][:, None] if t + 2 <= horizon else 0.0
        weighted = factors.loading[t + 1][:, None] * rest[t + 1] + decay * weighted
        if t not in blocks:
            continue
        moving = part.paid(t + 1, part.moving(part.ahead(t)))
        targets = [
            (summed[after] - summed[first]) / moving[first - t - 1 : after - t - 1].sum(axis=0)
            for first, after in blocks[t]
        ]
        targets += list(weighted / moving.sum(axis=0))
        yield functions(t, part.levels[t + 1], part.states[t]), np.array(targets)


def _solved(square: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The least-squares solution of normal equations; functions that are linearly dependent share
    their coefficient."""
    values, vectors = np.linalg.eigh(square)
    inverse = np.where(values > SMALLEST * values[-1], 1 / np.maximum(values, 1e-300), 0.0)
    return vectors @ (inverse[:, None] * (vectors.T @ right))


def sensitivities(factors: GaussianFactors, t: int) -> np.ndarray:
    """[T - t, F] the sensitivities of ln F(d), for d from t + 1 on, to the shocks of step t + 1."""
    decay = factors.decay[t + 1 :].copy()
    decay[0] = 1.0
    return factors.loading[t + 1 :] * np.cumprod(decay, axis=0)


def _hermite_sizes(degree: int) -> np.ndarray:
    """1 / sqrt(n!) for n from 0 to `degree`."""
    return np.cumprod(np.append(1.0, 1 / np.sqrt(np.arange(1, degree + 1))))
