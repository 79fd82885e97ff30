"""The numbers of a plan's rules, from the inputs of a case; the limits of trading and the scales of
the features, which are constant."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..people.cash_flows import reserved
from ..records.assets import Assets
from ..records.case import PensionModel, Scales
from ..records.inputs import use


class PlanTerms(NamedTuple):
    """The numbers of the rules, all scalars.

    For indexation: `cap` and `floor` per year, the funding ratios `lower`, `upper` and `required`.
    For contributions: `rate` and the limits `c_floor` and `c_cap` as shares of salaries,
    `loading`, `spread_factor` per year, the `target` ratio, `recovery_years`, and `sponsor`, the
    limit in money per year. For the liability: `reserved`, the amount reserved per unit of value
    of a payment.
    """

    cap: Array
    floor: Array
    lower: Array
    upper: Array
    required: Array
    rate: Array
    loading: Array
    spread_factor: Array
    target: Array
    recovery_years: Array
    c_floor: Array
    c_cap: Array
    sponsor: Array
    reserved: Array


def plan_terms(case: PensionModel, inputs: dict[str, Any]) -> PlanTerms:
    """The numbers of a case's rules, from its inputs; zeros where a rule does not need one."""
    indexed, paid = case.plan.indexation, case.plan.contribution
    values = (
        indexed.cap,
        indexed.floor,
        indexed.lower_ratio,
        indexed.upper_ratio,
        indexed.required_ratio,
        paid.rate,
        paid.loading,
        paid.spread_factor,
        paid.target_ratio,
        paid.recovery_years,
        paid.floor,
        paid.cap,
        paid.sponsor_limit,
    )
    return PlanTerms(*(use(inputs, item) for item in values), reserved=reserved(case, inputs))


class TradingLimits(NamedTuple):
    """Limits of weights and of trading (see `records.assets.Assets`): for the classes [n], and
    `group_low`, `group_high` for the groups [k]; `max_sale` and `turnover` are limits per step."""

    low: Float[Array, " n"]
    high: Float[Array, " n"]
    group_low: Float[Array, " k"]
    group_high: Float[Array, " k"]
    max_sale: Float[Array, " n"] | None
    band: Float[Array, " n"] | None
    turnover: Array | None

    @property
    def dealing(self) -> bool:
        """Whether trading has limits, in addition to those of the weights."""
        return any(item is not None for item in (self.max_sale, self.band, self.turnover))


def trading_limits(assets: Assets, step: float) -> TradingLimits:
    """The trading limits of a case."""
    groups = [
        xp.array([getattr(group, side) for group in assets.groups], float)
        for side in ("low", "high")
    ]
    return TradingLimits(
        # Copies: JAX remembers an array of the case in the type it met first.
        xp.array(assets.low),
        xp.array(assets.high),
        *groups,
        max_sale=None if assets.max_sale is None else xp.array(assets.max_sale) * step,
        band=None if assets.band is None else xp.array(assets.band),
        turnover=None if assets.turnover is None else xp.array(assets.turnover) * step,
    )


def scales(case: PensionModel) -> Scales:
    """The scales of the features. They follow from the numbers of the case, whatever the inputs
    are."""
    if case.derived is not None:
        return case.derived.scales
    rates, inflation, credit = case.rates, case.inflation, case.credit
    a = np.append(rates.mean_reversion.used(), inflation.mean_reversion.used())
    used = np.column_stack([rates.volatility.used(), inflation.volatility.used()]).mean(axis=0)
    reverting, values = credit.mean_reversion.used(), credit.volatility
    spread = values.used() if values.values.size else np.zeros(len(reverting))
    mortality = 1.0
    if case.lee_carter is not None:
        mortality = max(float(case.lee_carter.volatility.used()) * 10**0.5, 1e-9)
    return Scales(
        _after_ten_years(used, a), _after_ten_years(spread, reverting), np.asarray(mortality)
    )


def _after_ten_years(volatility: np.ndarray, mean_reversion: np.ndarray) -> np.ndarray:
    """Standard deviation of mean-reverting factors; 1 if they do not move."""
    deviation = volatility * np.sqrt(-np.expm1(-20 * mean_reversion) / (2 * mean_reversion))
    return np.where(deviation > 0, deviation, 1.0)
