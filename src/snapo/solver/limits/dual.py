"""Prices of limits while a policy is trained: an augmented Lagrangian.

After every step each limit is measured on the exact simulator and on that step's paths. Its
multiplier moves by a share of the excess, never below zero, and the price that the next step sees
is the multiplier and a part in proportion to the excess, which damps what the multiplier alone
would overshoot (Hestenes 1969; Stooke, Achiam and Abbeel 2020). Both count in deviations of a
path's totals, so that they mean the same in any units.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snapo.problem.limits import Limit
from snapo.problem.objective import Objective, Totals

MOVE, DAMP = 0.1, 3.0  # of a multiplier and of a price, for an excess of one deviation
LEAST = 1e-12


class Dual(NamedTuple):
    """For every limit its multiplier and its price now, empty before the first step."""

    multipliers: tuple[float, ...] = ()
    prices: tuple[float, ...] = ()

    @classmethod
    def read(cls, plain) -> "Dual":
        """From its fields as lists."""
        return cls(*(tuple(each) for each in plain))


def moved(
    dual: Dual, objective: Objective, limits: Sequence[Limit], totals: Totals, slower: float
) -> Dual:
    """The prices after a step with these exact totals; `slower`, 1 to 0, slows multipliers down
    towards the end."""
    old = dual.multipliers or (0.0,) * len(limits)
    excess = np.array([each.excess(totals) for each in limits])
    if not np.all(np.isfinite(excess)):
        return dual
    spread = np.array([_deviation(each.measure, totals) for each in limits])
    spread = np.maximum(spread, 0.1 * np.abs(excess))
    # An excess of one deviation, in the unit of a price: objective by measure.
    far = _deviation(objective, totals) / spread * excess / spread
    multipliers = np.maximum(np.array(old) + slower * MOVE * far, 0.0)
    prices = np.maximum(multipliers + DAMP * far, 0.0)
    return Dual(tuple(multipliers.tolist()), tuple(prices.tolist()))


def _deviation(objective: Objective, totals: Totals) -> float:
    """Of one path's share in an objective; at least a tenth of the largest share, since all paths
    may be alike."""
    shares = objective.influence(totals)
    return max(float(shares.std()), 0.1 * float(np.abs(shares).max()), LEAST)
