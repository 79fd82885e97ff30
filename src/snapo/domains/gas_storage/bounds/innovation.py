"""The fitted value in polynomials alone, on a few inventories: how each day surprises it.

The value of a policy scatters since prices surprise. Against the value of the store before its
price is known, the surprises of all days have a mean of zero whatever the policy does: they are its
control variate (Rogers, Mathematical Finance 12 (2002); Andersen and Broadie, Management Science 50
(2004)), and little is left of the scatter when the value is nearly right.
"""

from typing import NamedTuple

import numpy as np

from .regression import regression
from .value_iteration import FittedValue

LEVELS = 16


class InnovationTable(NamedTuple):
    """The value on T days and on the end date, as functions of inventory and price factors.

    - `low`, `high`: [T + 1] the interval of the levels, evenly spaced; beyond it the ends hold.
    - `now`: [T + 1, levels, n] coefficients of the functions of `FittedMarginal`; present values.
    - `ahead`: [T, levels, n] those of its expectation a day before, on the next date's levels.
    - `first`: its expectation on the valuation date.
    - `whiten`, `common`, `shift`: [T + 1, …], as in `FittedMarginal`.
    """

    low: np.ndarray
    high: np.ndarray
    now: np.ndarray
    ahead: np.ndarray
    first: float
    whiten: np.ndarray
    common: np.ndarray
    shift: np.ndarray


def innovation_table(fitted_value: FittedValue, levels: int = LEVELS) -> InnovationTable:
    """The table of a fitted value."""
    basis, dates, available = (
        fitted_value.basis,
        len(fitted_value.nodes),
        regression(fitted_value.basis),
    )
    low, high = (np.array([nodes[end] for nodes in fitted_value.nodes]) for end in (0, -1))
    now = np.stack(
        [
            fitted_value.at(t, np.linspace(low[t], high[t], levels)) @ available.day(t).plain
            for t in range(dates)
        ]
    )
    ahead = basis.expected_coefficients(now[1:])
    constant = np.all(basis.powers == 0, axis=1).astype(float)
    mean = np.append(constant, 1.0) if basis.common else constant
    return InnovationTable(low, high, now, ahead, float(now[0, 0] @ mean), *basis.linear())
