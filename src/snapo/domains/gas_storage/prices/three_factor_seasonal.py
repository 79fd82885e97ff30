"""`[model]` of kind "three-factor-seasonal": independent spot, long-term and seasonal factors."""

import datetime
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.plausible import Plausible
from snapo.case.table import CaseTable, doc
from snapo.problem.process import Factors
from snapo.problem.record import field
from snapo.problem.record.arrays import Float, jnp

from .factors import FactorPrices
from .process import REVERSION, SPEED, VOLATILITY, Delivery, Times, register, use


class SeasonalTable(CaseTable):
    """`[model]` of kind "three-factor-seasonal"."""

    kind: Literal["three-factor-seasonal"] = doc("spot, long-term and seasonal factors")
    spot_mean_reversion: CaseInput = REVERSION(
        "speed at which the spot price returns to the curve",
        plausible=Plausible(1.0, 1000.0, SPEED),
    )
    spot_volatility: CaseInput = VOLATILITY("volatility of the fast, mean-reverting factor")
    long_term_volatility: CaseInput = VOLATILITY("volatility of the whole curve, in parallel")
    seasonal_volatility: CaseInput = VOLATILITY(
        "volatility of the spread between summer and winter"
    )


@register
class ThreeFactorSeasonal(FactorPrices):
    """Loadings: s_spot (with mean reversion a), s_long and s_seas(T) = `seasonal_volatility` / 2 x
    `season`(T) (both without mean reversion). Source: the multi-factor seasonal model of the
    package cmdty-storage.

    - `spot_mean_reversion` (1/year), `spot_volatility`, `long_term_volatility`,
      `seasonal_volatility` (1/sqrt(year)): each is one number, index [].
    - `season`: [T + 1] cos(2 pi d / 365.25), d = days from 1 February of the valuation year.
    """

    kind = "three-factor-seasonal"
    table = SeasonalTable
    delivery: Times
    spot_mean_reversion: CaseInput
    spot_volatility: CaseInput
    long_term_volatility: CaseInput
    seasonal_volatility: CaseInput
    season: Float[np.ndarray, " T+1"]
    noise_size: int = field(static=True, default=3)
    fast_factor: int = field(static=True, default=0)

    @classmethod
    def of(cls, delivery: Delivery, **numbers: CaseInput):
        days = season(delivery.dates, delivery.valuation)
        return cls(delivery.times, season=days, **numbers)  # pyright: ignore

    def parameters(self, inputs) -> Factors:
        reversion = use(inputs, self.spot_mean_reversion)
        zero, flat = jnp.zeros_like(reversion), jnp.ones(len(self.times))
        loading = (
            use(inputs, self.spot_volatility) * flat,
            use(inputs, self.long_term_volatility) * flat,
            use(inputs, self.seasonal_volatility) / 2 * self.season,
        )
        return Factors(
            self.delivery.forward(inputs),
            jnp.stack([reversion, zero, zero]),
            jnp.stack(loading, axis=1),
            jnp.eye(3),
        )

    def describe(self) -> str:
        return "Three factors: spot (mean-reverting), long-term, seasonal"


def season(dates: Sequence[datetime.date], valuation: datetime.date) -> np.ndarray:
    """cos(2 pi d / 365.25), where d is the number of days from 1 February of the valuation year to
    each date."""
    peak = datetime.date(valuation.year, 2, 1)
    days = np.array([(date - peak).days for date in dates], np.float64)
    return np.cos(2 * math.pi * days / 365.25)
