"""The methods of a desk on supplied paths: intrinsic in products, rolling intrinsic, least squares.

Least-squares Monte Carlo: on simulated paths the value of the next day is regressed on prices,
backwards in time, on nodes of the level. The regression decides, but the value that is carried
backwards is that of the decisions on the path itself, so that errors of the regression do not
accumulate. The rule is then followed on other paths (out of sample), where it is a lower bound.
Sources: F. Longstaff, E. Schwartz, Review of Financial Studies 14 (2001); A. Boogert, C. de Jong,
"Gas storage valuation using a Monte Carlo method", Journal of Derivatives 15 (2008).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from snapo.lanes.machine.threads import cores

from ..bounds.basis import PolynomialBasis, gaussian_basis
from ..bounds.regression import product
from ..prices.process import GaussianFactors
from .flat import best, earned, interpolated, limits_on, peaks, slopes
from .forwards import PathCurves, drawn_states
from .products import TradedProducts
from .rolling import Chains, FlatContract, Link, TradeBlock, exactly, intrinsic_in, rolling

FITTED_BLOCK = 128  # paths at once: their arrays stay in the cache
RIDGE = 1e-9  # of the regression, against the sum of squares of the functions


@dataclass(frozen=True, eq=False)
class LeastSquaresRule:
    """The fitted value after each step. `coefficients`: T arrays [nodes, K] for the functions of
    `basis`."""

    contract: FlatContract
    links: Sequence[Link]
    basis: PolynomialBasis
    coefficients: list[np.ndarray]


def fitted_rule(
    contract: FlatContract, basis: PolynomialBasis, states: np.ndarray, spots: np.ndarray
) -> LeastSquaresRule:
    """The rule that is fitted on simulated factors [T + 1, F, N] and spot prices [T + 1, N]."""
    steps = range(contract.horizon)
    links = Chains(contract).of(tuple(TradeBlock(t, t + 1) for t in steps))
    nothing = np.zeros(spots.shape[1])
    value = contract.final(links[-1].nodes[:, None], spots[-1])
    value = np.broadcast_to(value, (len(links[-1].nodes), len(nothing)))
    coefficients = []
    for t in reversed(steps):
        period, nodes, value = links[t].period, links[t].nodes, links[t].later(value)
        functions = basis.functions(states[t : t + 1], t)[0]
        fit = _regressed(functions, value)
        before = np.empty((len(period.nodes), len(nothing)))
        for first in range(0, len(nothing), FITTED_BLOCK):
            some = slice(first, first + FITTED_BLOCK)
            slope = slopes(period, spots[t : t + 1, some], nothing[some])
            peak = peaks(period, slope, product(fit, functions[:, some]), nodes)
            _, q = best(period, limits_on(period), slope, peak, contract.every)
            reached = interpolated(value[:, some], nodes, period.keep[:, None] + period.span * q)
            before[:, some] = reached + earned(period, slope, q) - period.cost[:, None]
        value = before
        coefficients.append(fit)
    return LeastSquaresRule(contract, links, basis, coefficients[::-1])


def _regressed(functions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[nodes, K] coefficients of values [nodes, N] on functions [K, N]."""
    count = functions.shape[1]
    rows = [slice(first, first + FITTED_BLOCK) for first in range(0, count, FITTED_BLOCK)]
    moments = sum(product(functions[:, row], functions[:, row].T) for row in rows)
    target = sum(product(values[:, row], functions[:, row].T) for row in rows)
    scale = np.sqrt(np.maximum(np.diagonal(moments), 1e-300))
    moments = moments / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    return np.linalg.solve(moments, (target / scale).T).T / scale


class Followed(NamedTuple):
    """[N] the discounted money of each path, and its levels [T + 1, N]."""

    money: np.ndarray
    levels: np.ndarray


def followed(rule: LeastSquaresRule, states: np.ndarray, spots: np.ndarray) -> Followed:
    """The results of the rule on paths on which it was not fitted, with the exact limits."""
    contract, money = rule.contract, np.zeros(spots.shape[1])
    level, nothing = np.full_like(money, contract.start), np.zeros_like(money)
    levels = [level]
    for t, (link, fit) in enumerate(zip(rule.links, rule.coefficients)):
        period = link.period
        later = product(fit, rule.basis.functions(states[t : t + 1], t)[0])
        slope = slopes(period, spots[t : t + 1], nothing)
        limits, peak = exactly(contract, link, level), peaks(period, slope, later, link.nodes)
        q = best(period, limits, slope, peak, contract.every)[1][0]
        money = money + earned(period, slope, q) - limits.cost[0]
        level = limits.keep[0] + period.span * q
        lost, held = contract.settled(t, level), contract.end_cost(t, t + 1, level)
        money = money if held is None else money - held
        if lost is not None:
            money, level = money - lost, np.zeros_like(level)
        levels.append(level)
    return Followed(money + contract.final(level, spots[-1]), np.array(levels))


BLOCK = 256  # paths at once: their arrays stay in the cache
TRAINED = 4096  # paths of a regression
NO_CURVE = "its prices have risks other than Gaussian factors, so that paths have no forward curve"


@dataclass(frozen=True, eq=False)
class DeskMethods:
    """A contract of one level, the traded products, and paths.

    - `forward` [T + 1]: today's curve, with the price of the end date last.
    - `factors`: the factors of the prices; if they are None or not exact, paths have no forward
      curve.
    - `states` [T + 1, F, N]: the factors on paths; `spots` [T + 1, N]: the spot prices; `seed`: the
      seed of the paths of the regression.
    """

    contract: FlatContract
    products: TradedProducts
    forward: np.ndarray
    factors: GaussianFactors | None
    states: np.ndarray
    spots: np.ndarray
    seed: int

    def intrinsic(self) -> float:
        """The best plan in the products that can be traded today."""
        first = -1 if self.products.before else 0
        return intrinsic_in(self.contract, self.products.blocks(first), self.forward)

    def rolling(self) -> np.ndarray:
        """[N] the money of rolling intrinsic.

        **Raises:** `ValueError` if paths have no forward curve, or if the products do not fit the
        contract.
        """
        factors, chains = self._exact_factors, Chains(self.contract)
        steps = range(-1 if self.products.before else 0, self.contract.horizon)
        blocks = {t: self.products.blocks(t) for t in steps}
        for t in steps:
            chains.of(blocks[t])  # before the threads share them

        def money(first: int) -> np.ndarray:
            states = self.states[:, :, first : first + BLOCK]
            curves, before = PathCurves(factors, self.forward, states), self.products.before
            return rolling(chains, blocks.__getitem__, curves, states.shape[2], before).money

        with ThreadPoolExecutor(cores()) as pool:
            parts = pool.map(money, range(0, self.states.shape[2], BLOCK))
            return np.concatenate(list(parts))

    def least_squares(self) -> Followed:
        """The results, on these paths, of the rule of a regression on other paths.

        **Raises:** `ValueError` if prices have risks other than their factors.
        """
        factors = self._exact_factors
        basis = gaussian_basis(factors, priced=bool(np.any(self._end_price)))
        states = drawn_states(factors, TRAINED, self.seed)
        spots = PathCurves(factors, self.forward, states).spots
        return followed(fitted_rule(self.contract, basis, states, spots), self.states, self.spots)

    @property
    def _exact_factors(self) -> GaussianFactors:
        """The factors, if the spot prices of the paths follow from them."""
        factors, steps = self.factors, self.contract.horizon
        if factors is None or not factors.exact or factors.spikes is not None:
            raise ValueError(NO_CURVE)
        curves = PathCurves(factors, self.forward, self.states)
        if not np.allclose(curves.spots[:steps], self.spots[:steps], rtol=1e-5, atol=1e-5):
            raise ValueError(NO_CURVE)
        return factors

    @cached_property
    def _end_price(self) -> np.ndarray:
        """The change of the value of a unit left per unit of the price on the end date."""
        one = np.ones((1, 1))
        return self.contract.final(one, 2.0 * one[0]) - self.contract.final(one, one[0])
