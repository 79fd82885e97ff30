"""A year of life as a move of the mortality that a case gives."""

from typing import Any, NamedTuple

import numpy as np

from ..records.case import PensionCase
from ..records.people import FEMALE, MALE
from .annuities import year_of_life


class LongerLife(NamedTuple):
    """The input that moves, and by how much each of its numbers does [n]."""

    input: str
    change: np.ndarray


def longer_life(case: PensionCase, inputs: dict[str, Any]) -> LongerLife | None:
    """All death probabilities scaled, by sex, until the expectation of life at 65 is a year longer.

    The change is that of the multipliers, else of the death probabilities, else of the formula,
    whose hazards are scaled in their place, to first order in the scale. None where mortality is no
    input or no scale does it. A number that both sexes share moves by the mean of the two moves.
    """
    mortality = case.mortality
    if mortality is None:
        return None
    names = (mortality.multiplier.name, mortality.table.name, mortality.gompertz.name)
    name = next((each for each in names if each in inputs), None)
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
        place = mortality.multiplier.index
        size = values
    else:
        place = mortality.table.index
        size = np.where(values < 1, values, 0.0)
    times = np.bincount(place.ravel(), minlength=values.size)
    total = np.bincount(place.ravel(), np.repeat(scale, place.shape[1]), values.size)
    return LongerLife(name, size * total / np.maximum(times, 1))
