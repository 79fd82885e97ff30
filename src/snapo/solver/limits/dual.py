"""Prices of limits while a policy is trained: an augmented Lagrangian.

After every step each limit is measured on the exact simulator and on that step's paths. Its
multiplier moves by a share of the excess, never below zero, and the price that the next step sees
is the multiplier and a part in proportion to the excess, which damps what the multiplier alone
would overshoot (Hestenes 1969; Stooke, Achiam and Abbeel 2020).

The unit of an excess is the deviation of a path's measure, or the excess itself where that is
larger: a rule that decides nearly the same on all paths has a measure that hardly deviates. The
unit of a price is that at which the limit pulls at the policy as hard as the objective does, the
length of the one's derivative over that of the other. Totals do not tell it: the noise in an
objective may be far larger than all that decisions change, and a price that is far too large
drives decisions to a bound of their set, where no derivative leads out of again.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snapo.engine import BoundEngine
from snapo.problem.noise import Draws
from snapo.problem.objective import Limit, Objective, Totals
from snapo.problem.policy import Policy

from .slopes import slope_of

MOVE, DAMP = 0.1, 3.0  # of a multiplier and of a price, for an excess of one deviation
EVERY, KEPT = 5, 0.5  # steps between two measurements of a unit, and the share of those before
MINIMUM = 1e-12


class Dual(NamedTuple):
    """For every limit its multiplier, its price and the unit of a price now, empty before the first
    step."""

    multipliers: tuple[float, ...] = ()
    prices: tuple[float, ...] = ()
    units: tuple[float, ...] = ()

    @classmethod
    def read(cls, plain) -> "Dual":
        """From its fields as lists."""
        return cls(*(tuple(item) for item in plain))

    def due(self, step: int) -> bool:
        """Whether it is time to measure units: their derivatives cost as much as a step."""
        return not self.units or step % EVERY == 0

    def measured(
        self,
        bound_engine: BoundEngine,
        policy: Policy,
        draws: Draws,
        smooth,
        objective: Objective,
        limits: Sequence[Limit],
    ) -> "Dual":
        """With the units of prices on these paths, smoothed over the measurements before."""
        lengths = np.array([
            np.linalg.norm(slope_of(bound_engine, policy, draws, smooth, item))
            for item in (objective, *(limit.measure for limit in limits))
        ])  # fmt: skip
        with np.errstate(divide="ignore", invalid="ignore"):
            length = lengths[0] / lengths[1:]
        available = np.isfinite(length) & (length > 0)
        before = np.array(self.units) if self.units else np.where(available, length, np.nan)
        known_before = np.where(np.isnan(before), length, before)
        smoothed = known_before**KEPT * np.where(available, length, known_before) ** (1 - KEPT)
        return self._replace(units=tuple(np.where(available, smoothed, before).tolist()))


def updated_prices(
    dual: Dual, objective: Objective, limits: Sequence[Limit], totals: Totals, slower: float
) -> Dual:
    """The prices after a step with these exact totals; `slower`, 1 to 0, slows multipliers down
    towards the end."""
    old = np.array(dual.multipliers or (0.0,) * len(limits))
    excess = np.array([limit.excess(totals) for limit in limits])
    if not np.all(np.isfinite(excess)):
        return dual
    local = np.array([_deviation(item.measure, totals) for item in limits])
    # Where no derivative tells a unit, deviations do.
    units = np.array(dual.units) if dual.units else np.full(len(limits), np.nan)
    units = np.where(np.isnan(units), _deviation(objective, totals) / local, units)
    far = units * excess / np.maximum(local, np.abs(excess))
    # On a long way to the level the damping part leads alone: a multiplier that adds up all the way
    # goes far beyond. With much room it falls by a tenth at least, whatever the unit has become.
    move = far * local / np.maximum(local, np.abs(excess))
    move = np.where(excess < -local, np.minimum(far, -old), move)
    multipliers = np.maximum(old + slower * MOVE * move, 0.0)
    prices = np.maximum(multipliers + DAMP * far, 0.0)
    return dual._replace(multipliers=tuple(multipliers.tolist()), prices=tuple(prices.tolist()))


def _deviation(objective: Objective, totals: Totals) -> float:
    """Of one path's share in an objective; at least a tenth of the largest share, since all paths
    may be alike."""
    shares = objective.influence(totals)
    return max(float(shares.std()), 0.1 * float(np.abs(shares).max()), MINIMUM)
