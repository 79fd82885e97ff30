"""Life expectancy, and one more year of it as a move of the mortality of a case."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.either import with_numpy

from ..records.case import PensionCase
from ..records.people import FEMALE, MALE, PAYMENT_YEARS
from .mortality import Yearly, yearly

AT_AGE = 65
CLOSE = 1e-12  # of the scale of mortality, at which bisection stops
MINIMUM, MAXIMUM = 0.01, 1.0  # scales between which one more year is searched for


def life_expectancy(case: PensionCase, inputs: dict[str, Any], sex: int, age: int) -> float:
    """The complete expectation of life at `age` today, in years, improvement included: the sum over
    whole years of the probability of being alive, plus a half.
    """
    return _expectancy(_life(case, inputs, sex, age))


def year_of_life(case: PensionCase, inputs: dict[str, Any], sex: int) -> float:
    """The factor on all death probabilities of a sex that raises its life expectancy at 65 by
    one year.

    To first order, the effect of one more year is the sum of multiplier times (factor - 1) times
    the sensitivity to the multiplier.
    """
    life = _life(case, inputs, sex, AT_AGE)
    target = _expectancy(life) + 1
    low, high = MINIMUM, MAXIMUM
    if _expectancy(life, low) < target:
        raise ValueError("mortality: no scaling raises the life expectancy at 65 by a year.")
    while high - low > CLOSE:
        middle = (low + high) / 2
        if _expectancy(life, middle) > target:
            low = middle
        else:
            high = middle
    return (low + high) / 2


@with_numpy
def _life(case: PensionCase, inputs: dict[str, Any], sex: int, age: int) -> Yearly:
    """The mortality in each year from now on of a person who is `age` now."""
    years = np.arange(PAYMENT_YEARS)
    return yearly(case, inputs, np.array(sex), age + years, years)


@with_numpy
def _expectancy(life: Yearly, factor: float = 1.0) -> float:
    return float(np.exp(-np.cumsum(life.hazard(factor))).sum()) + 0.5


class LongerLife(NamedTuple):
    """The input that moves, and the `change` of each of its numbers [n]."""

    input: str
    change: np.ndarray


def longer_life(case: PensionCase, inputs: dict[str, Any]) -> LongerLife | None:
    """All death probabilities are scaled, by sex, until the life expectancy at 65 is a year longer.
    The input that changes is the first one that the case has of these: the multipliers, the death
    probabilities, and the parameters of the formula, with which hazards are scaled to first order.
    None if mortality is not an input, or if no scale suffices. A number that both sexes share moves
    by the mean of the two moves.
    """
    mortality = case.mortality
    if mortality is None:
        return None
    names = (mortality.multiplier.name, mortality.table.name, mortality.gompertz.name)
    name = next((item for item in names if item in inputs), None)
    if name is None:
        return None
    try:
        scale = np.array([year_of_life(case, inputs, sex) for sex in (MALE, FEMALE)]) - 1
    except ValueError:
        return None
    values = np.asarray(inputs[name])
    if name == mortality.gompertz.name:
        # Columns alpha, beta, makeham: hazards scale with exp(alpha) and with makeham.
        alpha_beta_makeham = np.stack([np.ones(2), np.zeros(2), values.reshape(2, 3)[:, 2]], 1)
        return LongerLife(name, (scale[:, None] * alpha_beta_makeham).ravel())
    if name == mortality.multiplier.name:
        position = mortality.multiplier.index
        size = values
    else:
        position = mortality.table.index
        size = np.where(values < 1, values, 0.0)
    times = np.bincount(position.ravel(), minlength=values.size)
    total = np.bincount(position.ravel(), np.repeat(scale, position.shape[1]), values.size)
    return LongerLife(name, size * total / np.maximum(times, 1))
