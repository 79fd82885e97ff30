"""Prices that may be negative: `[model]` of kind "one-factor-normal" and "one-factor-shifted"."""

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import NOT_NEGATIVE, Quantity, Range
from snapo.case.table import TableContext, doc
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, jnp

from .factors import FactorTable, GivenFactors, read_factors
from .process import Delivery, in_numpy, register, use

WIDE = 4.0  # standard deviations of the spot price that tables of prices show
PRICE_VOLATILITY = Quantity(
    "price/sqrt(year)", NOT_NEGATIVE, "volatility", move=1.0, limits=Range(0.0, 1e6)
)
SHIFT = Quantity("price", NOT_NEGATIVE, "price model", move=1.0, limits=Range(0.0, 1e9))


class SignedPrices(GivenFactors):
    """Factors of a price that may be negative and is therefore not proportional to the forward
    curve. The scale of prices for a policy does not change if a constant is added to the curve.
    """

    proportional = False

    def slow_level(self, constants, now, state):
        return jnp.asarray(1.0)

    def price_scale(self, prices, values):
        return float(np.std(prices)) + self._deviation(prices, values) or 1.0

    def price_spread(self, prices, values):
        return WIDE * self._deviation(prices, values)

    def _deviation(self, prices, values) -> float:
        """The typical standard deviation of a spot price."""
        reversion, loading = (in_numpy(values, x) for x in (self.mean_reversion, self.volatility))
        time = np.max(self.delivery.years, initial=0.0)
        rate = 2 * reversion * time
        left = np.where(rate > 1e-9, -np.expm1(-rate) / np.maximum(rate, 1e-9), 1.0) * time
        return float(np.mean(np.sqrt(np.sum(loading**2 * left, axis=-1))))


class NormalPriceTable(FactorTable):
    """`[model]` of kind "one-factor-normal"."""

    kind: Literal["one-factor-normal"] = doc("one factor, normal prices, which may be negative")
    volatility: CaseInput = PRICE_VOLATILITY("volatility in money, by delivery day", by="date")


@register
class NormalPrices(SignedPrices):
    """S(T) = F(T) + s(T) f(T), one Ornstein-Uhlenbeck factor; S is normal with E[S(T)] = F(T).

    The variance of S(T) is s^2 (1 - exp(-2 a T)) / (2 a). Source: Bachelier (1900), "Théorie de la
    spéculation"; Lucia and Schwartz (2002), "Electricity prices and power derivatives", with a
    one-factor model of the price, here fitted to the curve.
    """

    kind = "one-factor-normal"
    table = NormalPriceTable

    @classmethod
    def read(cls, section: TableContext, table: NormalPriceTable, delivery: Delivery):
        volatility = replace(table.volatility, unit=f"{delivery.curve.unit}/sqrt(year)")
        factor = table.model_copy(update={"volatility": volatility})
        return cls.of(delivery, **read_factors(section, [factor], [], [], delivery))

    def level(self, constants, now, state):
        return now.forward + jnp.sum(now.loading * state)

    def state_at(self, constants, now, spot):
        loading = now.loading[self.fast_factor]
        moved = (spot - now.forward) / jnp.where(loading > 0, loading, 1.0)
        state = jnp.zeros(self.noise_size)
        return state.at[self.fast_factor].set(jnp.where(loading > 0, moved, 0.0))

    def factors(self, schedule):
        return super().factors(schedule)._replace(additive=True)

    def describe(self) -> str:
        return "One mean-reverting factor, normal prices, which may be negative"


class ShiftedTable(FactorTable):
    """`[model]` of kind "one-factor-shifted"."""

    kind: Literal["one-factor-shifted"] = doc(
        "one factor; the price plus a shift is lognormal, so that prices may be negative"
    )
    shift: CaseInput = SHIFT("shift; the spot price is always above minus this number")


class ShiftedConstants(NamedTuple):
    """The constants of the factors, and the `shift`."""

    first_shock: Array
    size: Array
    before: Array
    shift: Array


@register
class Shifted(SignedPrices):
    """S(T) = (F(T) + h) exp(s(T) f(T) - variance / 2) - h, one Ornstein-Uhlenbeck factor.

    S(T) + h is lognormal with mean F(T) + h, so that E[S(T)] = F(T) and S(T) > -h. For a large h
    and s = v / (F + h) it tends to the normal price with volatility v. Source: Rubinstein (1983),
    "Displaced diffusion option pricing".
    """

    kind = "one-factor-shifted"
    table = ShiftedTable
    shift: CaseInput = field(kw_only=True)

    @classmethod
    def read(cls, section: TableContext, table: ShiftedTable, delivery: Delivery):
        shift = replace(table.shift, unit=delivery.curve.unit)
        lowest = float(np.min(delivery.curve.used(), initial=np.inf))
        if lowest + float(shift.values[0]) <= 0:
            message = f"the lowest forward price is {lowest:g}: the shift must be above"
            raise section.error("shift", float(shift.values[0]), f"{message} {-lowest:g}")
        numbers: dict[str, Any] = read_factors(section, [table], [], [], delivery)
        return cls.of(delivery, **numbers, shift=shift)

    @property
    def lowest(self) -> float:
        return -float(self.shift.values[0])

    def prepare(self, inputs) -> Schedule:
        made = super().prepare(inputs)
        shift = use(inputs, self.shift)
        return Schedule(ShiftedConstants(*made.constants, shift=shift), made.steps)

    def level(self, constants, now, state):
        noise = jnp.exp(jnp.sum(now.loading * state) - now.variance / 2)
        return (now.forward + constants.shift) * noise - constants.shift

    def state_at(self, constants, now, spot):
        least = 1e-9 * (now.forward + constants.shift)
        shifted = jnp.maximum(spot + constants.shift, least)
        return super().state_at(constants, now._replace(forward=now.forward + constants.shift),
                                shifted)  # fmt: skip

    def factors(self, schedule):
        return super().factors(schedule)._replace(shift=float(schedule.constants.shift))

    def _deviation(self, prices, values) -> float:
        mean = float(np.mean(prices)) + float(in_numpy(values, self.shift))
        return mean * super()._deviation(prices, values)

    def describe(self) -> str:
        return "One mean-reverting factor, lognormal prices shifted so that they may be negative"
