"""Spot prices of power, a fuel and an emission certificate; a unit of fuel needs e certificates.

The two prices of `pair.py`, and a third price of the same kind. The cash of a contract depends on
the price of power and on the cost of fuel with its certificates, G + e c. The certificate has a
separate factor, and the shocks of all three are correlated. Transitions are exact for steps of any
length.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.process import Factors, integral
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, jnp

from .pair import CommodityPair, SecondCommodity, SecondRows
from .process import GaussianFactors, KnownPrices, use


class FuelRows(NamedTuple):
    """Fuel and certificates on each date [T + 1]; `share`: the number of certificates for a unit of
    fuel."""

    fuel: SecondRows
    certificate: SecondRows
    share: Array

    def expected(self) -> Array:
        """[T + 1] today's expectation of the cost."""
        return self.fuel.forward + self.share * self.certificate.forward

    def price(self, factors):
        """The cost of a unit of fuel if the three factors have these values."""
        return self.fuel.price(factors[1]) + self.share * self.certificate.price(factors[2])


class FuelWithCertificates(NamedTuple):
    """The cost of fuel with certificates, as dynamic programs use it; the factors of the two are
    the last ones."""

    rows: FuelRows
    carry: np.ndarray
    renewed = False

    @property
    def one_factor(self) -> bool:
        """Whether the price of certificates is not random, so that only one factor moves the
        cost."""
        return not np.any(self.rows.certificate.variance)

    def price(self, of: GaussianFactors, t: int, g: np.ndarray) -> np.ndarray:
        """[n] the cost on date t if the factor of fuel has these values [n].

        **Raises:** `ValueError` if the cost also depends on the factor of certificates.
        """
        if not self.one_factor:
            raise ValueError("a lattice supports one or two price factors, but prices have 3")
        rows = self.rows
        fuel = SecondCommodity(rows.fuel, self.carry).price(of, t, g)
        return fuel + rows.share[t] * rows.certificate.forward[t]

    def at(self, of: GaussianFactors, t: int, factors: np.ndarray) -> np.ndarray:
        """[n] the cost on date t if all factors have these values [3, n]."""
        fuel, certificate = (SecondCommodity(x, self.carry) for x in self.rows[:2])
        cost = self.rows.share[t] * certificate.price(of, t, factors[2])
        return fuel.price(of, t, factors[1]) + cost


class CommodityTrio(CommodityPair):
    """Three commodities; see the top of this file.

    - `reversions`, `volatilities`: the mean reversions and volatilities of all three;
      `correlation`: the correlations of power and fuel, of power and certificates, and of fuel and
      certificates.
    - `third_curve`: forward prices of certificates, index [T]; `share`: the number of certificates
      per unit of fuel.
    """

    third_curve: CaseInput = field(kw_only=True)
    share: CaseInput = field(kw_only=True)
    noise_size: int = field(static=True, default=3)

    def parameters(self, inputs: Any) -> Factors:
        loading, none = use(inputs, self.volatilities[0]), jnp.zeros(())
        first, second, third = (use(inputs, self.correlation)[i] for i in range(3))
        upper = jnp.stack([none, first, second, none, none, third, none, none, none]).reshape(3, 3)
        return Factors(
            self.delivery.forward(inputs),
            jnp.stack([use(inputs, x) for x in self.reversions]),
            jnp.stack([loading, *[jnp.zeros_like(loading)] * 2], axis=1),
            jnp.eye(3) + upper + upper.T,
        )

    def prepare(self, inputs: Any) -> Schedule:
        rows, loading = super().prepare(inputs), use(inputs, self.volatilities[2])
        curve, speed = use(inputs, self.third_curve), use(inputs, self.reversions[2])
        curve = jnp.append(curve, curve[-1:])
        variance = loading**2 * integral(2 * speed, jnp.asarray(self.delivery.years))
        third = SecondRows(curve, loading, variance)
        share = jnp.broadcast_to(use(inputs, self.share), curve.shape)
        return Schedule(
            rows.constants, rows.steps._replace(index=FuelRows(rows.steps.index, third, share))
        )

    def second_price(self):
        fuel, none = super().second_price().index, np.zeros(0)
        certificate: Any = self.third_curve.used(), none, none
        share: Any = self.share.used()
        return KnownPrices(FuelRows(fuel, SecondRows(*certificate), share))

    def index(self, constants, now, state):
        return now.index.price(state)

    def factors(self, schedule):
        of, count = super().factors(schedule), len(schedule.steps.loading)
        carry = np.zeros((count, 3, 3))
        return of._replace(index=FuelWithCertificates(schedule.steps.index, carry))

    def describe(self) -> str:
        return "Three commodities, each with one mean-reverting factor, correlated"
