"""Spot prices of two commodities, each with one mean-reverting factor, whose shocks are correlated.

    S_i(t) = F_i(t) exp(v_i(t) f_i(t) - variance_i(t) / 2),   df_i = -a_i f_i dt + dW_i,
    dW_1 dW_2 = rho dt

so that E[S_i(t)] = F_i(t). Transitions are exact for steps of any length: the shocks of a step of
length h have the covariance rho (1 - exp(-(a_1 + a_2) h)) / (a_1 + a_2).
"""

from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.process import Factors, integral
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, jnp

from .factors import FactorPrices, FactorTable
from .process import GaussianFactors, KnownPrices, Times, TwoPrices, use


class SecondRows(NamedTuple):
    """The second commodity on each date [T + 1]: its forward price, volatility, and variance of ln
    S."""

    forward: Array
    loading: Array
    variance: Array

    def expected(self) -> Array:
        """[T + 1] today's expectation of the price of the second commodity."""
        return self.forward

    def price(self, factor):
        """The spot price of the second commodity if its factor has this value."""
        return self.forward * jnp.exp(self.loading * factor - self.variance / 2)


class PairStep(NamedTuple):
    """A row of `StorageStep` for the first commodity, and a row for the second: `index`."""

    forward: Array
    loading: Array
    variance: Array
    next_decay: Array
    next_shock: Array
    slow_variance: Array
    index: SecondRows


class SecondCommodity(NamedTuple):
    """The second commodity as dynamic programs use it; its factor is the last one."""

    rows: SecondRows
    carry: np.ndarray
    renewed = False
    one_factor = True  # moves this price

    def price(self, of: GaussianFactors, t: int, g: np.ndarray) -> np.ndarray:
        """[n] the price of the second commodity on date t if the last factor has these values
        [n]."""
        forward, loading, variance = (np.asarray(x[t]) for x in self.rows)
        return of.spot(forward, of.noise(loading * g, variance))

    def at(self, of: GaussianFactors, t: int, factors: np.ndarray) -> np.ndarray:
        """[n] the price of the second commodity on date t if all factors have these values [F,
        n]."""
        return self.price(of, t, factors[-1])


class CommodityPair(FactorPrices, TwoPrices):
    """Two commodities; see the top of this file. The price of the first is the spot price, the
    price of the second the index.

    - `delivery`: the delivery of the first; `second_curve`: forward prices of the second, index
      [T].
    - `reversions`, `volatilities`: the mean reversion and the volatility of each, index [] and [T +
      1]; `correlation`: the correlation of their shocks.
    """

    delivery: Times
    second_curve: CaseInput
    reversions: tuple[CaseInput, ...]
    volatilities: tuple[CaseInput, ...]
    correlation: CaseInput
    kind: ClassVar[str] = "pair"  # pyright: ignore[reportIncompatibleVariableOverride]
    table: ClassVar[type] = FactorTable  # pyright: ignore[reportIncompatibleVariableOverride]
    noise_size: int = field(static=True, default=2)
    fast_factor: int = field(static=True, default=0)

    def parameters(self, inputs: Any) -> Factors:
        loading = use(inputs, self.volatilities[0])
        rho = use(inputs, self.correlation)
        return Factors(
            self.delivery.forward(inputs),
            jnp.stack([use(inputs, x) for x in self.reversions]),
            jnp.stack([loading, jnp.zeros_like(loading)], axis=1),
            jnp.eye(2) + rho * (1 - jnp.eye(2)),
        )

    def prepare(self, inputs: Any) -> Schedule:
        rows, loading = super().prepare(inputs), use(inputs, self.volatilities[1])
        curve, speed = use(inputs, self.second_curve), use(inputs, self.reversions[1])
        curve = jnp.append(curve, curve[-1:])
        variance = loading**2 * integral(2 * speed, jnp.asarray(self.delivery.years))
        second = SecondRows(curve, loading, variance)
        return Schedule(rows.constants, PairStep(*rows.steps, index=second))

    def second_price(self) -> KnownPrices:
        rows: Any = self.second_curve.used(), np.zeros(0), np.zeros(0)
        return KnownPrices(SecondRows(*rows))

    def index(self, constants, now, state):
        return now.index.price(state[1])

    def factors(self, schedule):
        of, count = super().factors(schedule), len(schedule.steps.loading)
        carry = np.zeros((count, 2, 2))
        return of._replace(index=SecondCommodity(schedule.steps.index, carry))

    def describe(self) -> str:
        return "Two commodities, each with one mean-reverting factor, correlated"
