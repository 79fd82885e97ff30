"""Textbook figures of a life: annuities, and a year of life in a case's mortality."""

from typing import Any

import jax
import numpy as np

from ..records.case import PensionCase
from ..records.people import PAYMENT_YEARS
from .mortality import Yearly, yearly

AT_AGE = 65
CLOSE = 1e-12  # of the scale of mortality, at which bisection stops
LEAST, MOST = 0.01, 1.0  # scales between which one more year is looked for


def annuity_due(probability: np.ndarray, age: int, rate: float) -> float:
    """Value of 1 a year in advance for life: sum of v^k kp_x, v = 1 / (1 + rate).

    `probability`: q by age from 0 on; nobody lives beyond its end.
    """
    survival = np.concatenate([[1.0], np.cumprod(1 - np.asarray(probability)[age:])])
    return float(np.sum(survival * (1 + rate) ** -np.arange(len(survival))))


def life_expectancy(case: PensionCase, inputs: dict[str, Any], sex: int, age: int) -> float:
    """Complete expectation of life of who is `age` at time 0, years, improvement included.

    The sum over whole years of the probability to be alive, plus a half.
    """
    with jax.enable_x64(True):
        return _expectancy(_life(case, inputs, sex, age))


def year_of_life(case: PensionCase, inputs: dict[str, Any], sex: int) -> float:
    """The factor on all death probabilities of a sex that raises its expectation of life at 65 by
    one year.

    A first-order effect of one more year is the sum of multiplier times (factor - 1) times the
    sensitivity to the multiplier.
    """
    life = _life(case, inputs, sex, AT_AGE)
    target = _expectancy(life) + 1
    low, high = LEAST, MOST
    if _expectancy(life, low) < target:
        raise ValueError("mortality: no scaling raises the expectation of life at 65 by a year.")
    while high - low > CLOSE:
        middle = (low + high) / 2
        if _expectancy(life, middle) > target:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _life(case: PensionCase, inputs: dict[str, Any], sex: int, age: int) -> Yearly:
    """Each year from now on of who is `age` now."""
    years = np.arange(PAYMENT_YEARS)
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, yearly(case, inputs, np.array(sex), age + years, years))


def _expectancy(life: Yearly, factor: float = 1.0) -> float:
    with jax.enable_x64(True):
        return float(np.exp(-np.cumsum(np.asarray(life.hazard(factor)))).sum()) + 0.5
