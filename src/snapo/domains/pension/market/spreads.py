"""Credit spreads s, one for each rating, where u = ln(s / mean) reverts to zero; and the effect of
currencies on returns: the unhedged share, the cost of hedging and the premium.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import xp

from ..records.case import PensionModel
from ..records.inputs import use


class SpreadTerms(NamedTuple):
    """R ratings: `fading` the share of u that remains after a step, `volatility` of its shock."""

    fading: Array
    volatility: Array


def spread_terms(case: PensionModel, inputs: dict[str, Any]) -> SpreadTerms:
    """The numbers of a case's ratings."""
    credit = case.credit
    fading = xp.exp(-use(inputs, credit.mean_reversion) * case.step)
    return SpreadTerms(fading, use(inputs, credit.volatility))


def spread_now(case: PensionModel, inputs: dict[str, Any]) -> Array | None:
    """[R] u today; None in a case without ratings."""
    if not case.credit.names:
        return None
    return xp.log(use(inputs, case.credit.spread) / use(inputs, case.credit.mean_spread))


def next_spread(terms: SpreadTerms, spread: Array | None, shock: Array) -> Array | None:
    """[R] u after a step; `shock` [R] of the Gaussian vector."""
    return None if spread is None else terms.fading * spread + terms.volatility * shock


class CurrencyTerms(NamedTuple):
    """X currencies, per step and unit of holding: `exposure`: the volatility of the unhedged
    share; `premium`: its mean return over the difference of rates; `hedging`: minus the cost of
    the hedge."""

    exposure: Array
    premium: Array
    hedging: Array


def currency_terms(case: PensionModel, inputs: dict[str, Any]) -> CurrencyTerms:
    """The numbers of a case's currencies."""
    hedge = use(inputs, case.currencies.hedge_ratio)
    return CurrencyTerms(
        exposure=(1 - hedge) * use(inputs, case.currencies.volatility),
        premium=(1 - hedge) * use(inputs, case.currencies.premium) * case.step,
        hedging=-hedge * use(inputs, case.currencies.hedge_cost) * case.step,
    )


def of_currency(values: Array, currency: np.ndarray) -> Array:
    """The entry of `values` [X] for each asset's currency; zero for the fund's own currency
    (-1)."""
    return xp.append(values, xp.zeros(1, values.dtype))[currency]
