"""Currencies in returns: the unhedged share, the cost of hedging and the premium."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..records.case import PensionModel
from ..records.inputs import use


class CurrencyTerms(NamedTuple):
    """X currencies, per step and unit of holding: `exposure` the volatility of the unhedged share,
    `premium` its mean over the difference of rates, `hedging` minus the cost of the hedge."""

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
    """`values` [X] where a currency is held, zero where none is (-1)."""
    return jnp.append(values, jnp.zeros(1, values.dtype))[currency]
