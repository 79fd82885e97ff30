"""Prices and wages in each step, around the factor of expected inflation."""

from typing import Any, NamedTuple

from jaxtyping import Array

from ..records.case import PensionCase
from ..records.inputs import use
from .factors import Factors
from .shocks import Slots


class Growth(NamedTuple):
    """Growth of ln I and ln W: `price` [T] the shift, `index_volatility` [T], and for wages on top
    `wage` (per step) and `wage_volatility`."""

    price: Array
    index_volatility: Array
    wage: Array
    wage_volatility: Array


def growth(case: PensionCase, inputs: dict[str, Any], factors: Factors, shift: Array) -> Growth:
    """`shift` [T] is that of nominal less that of real bonds: the break-even index, fitted.

    ln I' - ln I = shift + int p + s_I (dW_I + lambda_I d), where int p has its own price of risk.
    """
    inflation = case.inflation
    volatility = use(inputs, inflation.index_volatility)
    risk = use(inputs, inflation.index_price_of_risk) * (0.0 if case.risk_neutral else case.step)
    drift = factors.volatility[:, -1] * factors.price_of_risk[-1] * factors.reached[-1]
    return Growth(
        price=shift + drift + volatility * risk,
        index_volatility=volatility,
        wage=use(inputs, inflation.real_wage_growth) * case.step,
        wage_volatility=use(inputs, inflation.wage_volatility),
    )


class Grown(NamedTuple):
    """The indices after a step, in logs."""

    price: Array
    wage: Array


def grow(price: Array, wage: Array, expected: Array, now, terms, place: Slots, shock) -> Grown:
    """The next ln I and ln W; `expected` is the integral of the factor over the step, `shock` the
    Gaussian vector."""
    move = now.price_shift + expected + now.index_volatility * shock[place.index]
    extra = terms.wage_growth + terms.wage_volatility * shock[place.wage]
    return Grown(price + move, wage + move + extra)
