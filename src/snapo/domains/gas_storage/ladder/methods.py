"""The methods of a desk on given paths: intrinsic in products, rolling intrinsic, least squares."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from snapo.lanes.machine.threads import cores

from ..bounds.basis import gaussian_basis
from ..prices.process import GaussianFactors
from .forwards import PathCurves, drawn_states
from .least_squares import Followed, fitted_rule, followed
from .products import TradedProducts
from .rolling import Chains, FlatContract, intrinsic_in, rolling

BLOCK = 256  # paths at once: their arrays stay in the cache
TRAINED = 4096  # paths of a regression
NO_CURVE = "its prices have other risks than Gaussian factors, so that no path has a forward curve"


@dataclass(frozen=True, eq=False)
class DeskMethods:
    """A contract of one level, the traded products, and paths.

    - `forward` [T + 1]: today's curve, the price of the end last.
    - `factors`: of the prices; None, or not exact: no path has a forward curve.
    - `states` [T + 1, F, N] of the factors, `spots` [T + 1, N]; `seed`: of the regression's paths.
    """

    contract: FlatContract
    products: TradedProducts
    forward: np.ndarray
    factors: GaussianFactors | None
    states: np.ndarray
    spots: np.ndarray
    seed: int

    def intrinsic(self) -> float:
        """The best plan in the products that trade today."""
        first = -1 if self.products.before else 0
        return intrinsic_in(self.contract, self.products.blocks(first), self.forward)

    def rolling(self) -> np.ndarray:
        """[N] the money of rolling intrinsic.

        **Raises:** `ValueError` where paths have no forward curve, or products do not fit.
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
        """The rule of a regression on other paths, on these.

        **Raises:** `ValueError` where prices have other risks than their factors'.
        """
        factors = self._exact_factors
        basis = gaussian_basis(factors, priced=bool(np.any(self._end_price)))
        states = drawn_states(factors, TRAINED, self.seed)
        spots = PathCurves(factors, self.forward, states).spots
        return followed(fitted_rule(self.contract, basis, states, spots), self.states, self.spots)

    @property
    def _exact_factors(self) -> GaussianFactors:
        """The factors, where they make the spot prices of the paths."""
        factors, steps = self.factors, self.contract.horizon
        if factors is None or not factors.exact or factors.spikes is not None:
            raise ValueError(NO_CURVE)
        curves = PathCurves(factors, self.forward, self.states)
        if not np.allclose(curves.spots[:steps], self.spots[:steps], rtol=1e-5, atol=1e-5):
            raise ValueError(NO_CURVE)
        return factors

    @cached_property
    def _end_price(self) -> np.ndarray:
        """How the value of a unit left depends on the price of the end."""
        one = np.ones((1, 1))
        return self.contract.final(one, 2.0 * one[0]) - self.contract.final(one, one[0])
