"""The fitted value as a guide: marginal values of gas, polynomials in the price factors by day.

The expectation of the fitted value has hinges; after a day's noise they are smooth, and their
best polynomials stand for them, so that a policy has few numbers to compute.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..references.slope_table import ROWS, slope_table
from .regression import regression
from .value_iteration import FittedValue


class FittedMarginal(NamedTuple):
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] of the table, see `SlopeTable`.
    - `above`, `below`: [T, rows, n] on either side: of the polynomials of the basis times its
      exponential and, where there is one, of the constant.
    - `whiten`: [T, kept, F], `common` [T, F], `shift` [T]: y = whiten f, ln g = common f - shift.
    """

    low: np.ndarray
    high: np.ndarray
    above: np.ndarray
    below: np.ndarray
    whiten: np.ndarray
    common: np.ndarray
    shift: np.ndarray


def fitted_marginal(schedule, fitted_value: FittedValue) -> FittedMarginal:
    """The table of a fitted value; beyond the inventories that it knows, the last slope goes on."""
    basis, steps = fitted_value.basis, schedule.steps
    horizon, rows = len(steps.forward), slope_table(schedule)
    available = regression(basis)
    size = len(basis.powers) + bool(basis.common)
    table = np.zeros((2, horizon, ROWS, size))
    for t in range(horizon):
        nodes, drift = fitted_value.nodes[t + 1], available.day(t).drift
        if nodes.size == 1:  # no choice of inventory: the spot is as good as any
            table[:, t, :, 0] = steps.gas_discount[t] * steps.forward[t]
            continue
        sides = rows.slopes(t, partial(fitted_value.at, t + 1), nodes[0], nodes[-1])
        table[:, t] = [slope @ drift for slope in sides]
    linear = basis.linear()
    return FittedMarginal(rows.low, rows.high, *table, *(x[:horizon] for x in linear))
