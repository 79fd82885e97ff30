"""The fitted value as a guide: marginal values of gas, polynomials in the price factors by day.

The expectation of the fitted value has hinges; after a day's noise they are smooth, and their
best polynomials stand for them, so that a policy has few numbers to compute.
"""

from typing import NamedTuple

import numpy as np

from .regression import regression
from .value_iteration import FittedValue

LEVELS = 16
WIDTH = 0.01  # of the interval of a day: slopes are taken over twice that


class FittedMarginal(NamedTuple):
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] the interval of the levels, evenly spaced.
    - `coefficients`: [T, levels, n]: of the polynomials of the basis times its exponential and,
      where there is one, of the constant.
    - `whiten`: [T, kept, F], `common` [T, F], `shift` [T]: y = whiten f, ln g = common f - shift.
    """

    low: np.ndarray
    high: np.ndarray
    coefficients: np.ndarray
    whiten: np.ndarray
    common: np.ndarray
    shift: np.ndarray


def fitted_marginal(schedule, fitted: FittedValue, levels: int = LEVELS) -> FittedMarginal:
    """The table of a fitted value; beyond the inventories that it knows, the last slope goes on."""
    basis, steps = fitted.basis, schedule.steps
    horizon = len(steps.forward)
    known = regression(basis)
    size = len(basis.powers) + bool(basis.common)
    table = np.zeros((horizon, levels, size))
    for t in range(horizon):
        slope = _slopes(fitted, t + 1, steps.next_low[t], steps.next_high[t], levels)
        table[t] = slope @ known.day(t).drift
        if fitted.nodes[t + 1].size == 1:  # no choice of inventory: the spot is as good as any
            table[t] = 0.0
            table[t, :, 0] = steps.gas_discount[t] * steps.forward[t]
    linear = basis.linear()
    return FittedMarginal(
        steps.next_low.copy(), steps.next_high.copy(), table, *(x[:horizon] for x in linear)
    )


def _slopes(fitted: FittedValue, t: int, low: float, high: float, levels: int) -> np.ndarray:
    """[levels, K] slopes of the value on day t by the inventory."""
    nodes = fitted.nodes[t]
    width = max(WIDTH * (high - low), 1e-9)
    centre = np.clip(np.linspace(low, high, levels), nodes[0], nodes[-1])
    left, right = np.maximum(centre - width, nodes[0]), np.minimum(centre + width, nodes[-1])
    run = np.maximum(right - left, 1e-12)[:, None]
    return (fitted.at(t, right) - fitted.at(t, left)) / run
