"""Classes with a separate shock, from equity to hedge funds: lognormal, with mean and volatility
from the case.

Under "Q" the drift over cash is minus half the variance, so that the class earns cash on average.
Under "P" the mean is the case's (see `records.assets.Assets`).
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...records.assets import AttributionPart
from ...records.case import PensionModel
from ...records.inputs import use
from ..shocks import slots
from ..spreads import of_currency
from .asset_class import AssetClass, Scene, register


class PricedSteps(NamedTuple):
    """`drift` [T, k] of log returns without that of cash, `volatility` [T, k] in local currency."""

    drift: Array
    volatility: Array


class Priced(AssetClass):
    """A class with a separate shock; equity, property and others are subclasses."""

    columns: ClassVar[tuple[str, ...]] = ("mean", "volatility", "smoothing")
    without: ClassVar[str] = "its return has a separate mean and volatility"
    part: ClassVar[AttributionPart] = "assets"
    own_shock: ClassVar[bool] = True

    @classmethod
    def read(cls, row, names):
        return {}

    @classmethod
    def prepare(cls, scene, positions):
        case, inputs, rank = scene.case, scene.inputs, _rank(scene.case, positions)
        currency = cls.currencies(case, positions)
        volatility = use(inputs, case.assets.volatility)[:, rank]
        variance = _variance(scene, rank, volatility, currency)
        drift = _drift(case, inputs, rank, variance)
        if case.assets.return_kind == "excess" and not case.risk_neutral:
            drift = drift + of_currency(scene.currencies.premium, currency)
        drift = drift + of_currency(scene.currencies.hedging, currency)
        return None, PricedSteps(drift, volatility)

    @classmethod
    def log_return(cls, case, positions, terms, steps, now):
        shock = now.shock[slots(case).asset][_rank(case, positions)]
        local = steps.drift + steps.volatility * shock
        if now.foreign is not None:
            local = local + of_currency(now.foreign, cls.currencies(case, positions))
        total = case.assets.return_kind == "total" and not case.risk_neutral
        return local if total else local + now.cash

    @classmethod
    def payments(cls, case, positions):
        return None


def _rank(case: PensionModel, positions) -> np.ndarray:
    """The positions [k] among the classes with a separate shock."""
    return np.array([case.assets.shocks.index(i) for i in positions], int)


def _variance(scene: Scene, rank: np.ndarray, volatility: Array, currency) -> Float[Array, "T k"]:
    """Variance of a step's return, currency included."""
    position = slots(scene.case)
    local = np.arange(position.size)[position.asset][rank]
    foreign = np.where(currency >= 0, position.currency.start + currency, 0)
    e = of_currency(scene.currencies.exposure, currency)
    both = 2 * volatility * e * scene.covariance[local, foreign]
    alone = volatility**2 * scene.covariance[local, local]
    return alone + both + e**2 * scene.covariance[foreign, foreign]


def _drift(case: PensionModel, inputs: dict[str, Any], rank: np.ndarray, variance: Array) -> Array:
    """Mean of a step's log return, currencies excluded."""
    if case.risk_neutral:
        return -variance / 2
    mean = use(inputs, case.assets.mean)[rank]
    if case.assets.mean_kind == "log":
        return mean * case.step + 0 * variance
    drift = xp.log1p(mean) * case.step
    return drift - variance / 2 if case.assets.mean_kind == "arithmetic" else drift + 0 * variance


@register
@dataclass(frozen=True)
class Equity(Priced):
    """Shares, lognormal with a separate shock."""

    kind: ClassVar[str] = "equity"
    description: ClassVar[str] = (
        "shares, listed or private, and infrastructure; lognormal, with mean and volatility"
    )
    risk: ClassVar[str] = "developed"


@register
@dataclass(frozen=True)
class Property(Priced):
    """Property, lognormal with a separate shock."""

    kind: ClassVar[str] = "property"
    description: ClassVar[str] = (
        "buildings and land; lognormal, with mean and volatility; appraised values have a lag"
    )
    risk: ClassVar[str] = "unlisted-property"


@register
@dataclass(frozen=True)
class Commodity(Priced):
    """Commodities, lognormal with a separate shock."""

    kind: ClassVar[str] = "commodity"
    description: ClassVar[str] = "commodities; lognormal, with mean and volatility"
    risk: ClassVar[str] = "commodity"


@register
@dataclass(frozen=True)
class HedgeFund(Priced):
    """A strategy without a market index, lognormal with a separate shock."""

    kind: ClassVar[str] = "hedge-fund"
    description: ClassVar[str] = (
        "hedge funds and other alternatives; lognormal, with mean and volatility"
    )
    risk: ClassVar[str] = "unlisted"
