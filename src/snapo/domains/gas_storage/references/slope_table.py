"""Where a guide's marginal values are tabulated: inventories by day, and a slope on either side.

A store that is filled and emptied by fixed daily volumes has values with corners at the multiples
of these: the next unit injected is worth the slope above, the last one withdrawn the slope below.
Rows of the table lie on the corners and half-way between, where volumes have a common measure.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

PIECES = 16  # between two levels
ROWS = 2 * PIECES + 1  # one at each level, and one half-way to the next
THIRD = 3  # parts of a piece: a slope at a corner is taken over one part
COMMON, DIVISORS = 0.05, 4  # how near daily volumes are to multiples, and of what part of the least


class SlopeTable(NamedTuple):
    """Rows of a table, by day.

    - `low`, `high`: [T] the first and the last row; the rows between are evenly spaced.
    - `next_low`, `next_high`: [T] the inventories that the day can end with.
    - `corners`: whether levels lie on corners, so that a slope has two sides.
    """

    low: np.ndarray
    high: np.ndarray
    next_low: np.ndarray
    next_high: np.ndarray
    corners: bool

    def nodes(self, t: int) -> np.ndarray:
        """Inventories at the end of day t: the parts of all pieces, and both ends of the day."""
        low, high = self.next_low[t], self.next_high[t]
        if high <= low:
            return np.array([low])
        every = np.linspace(self.low[t], self.high[t], THIRD * PIECES + 1)
        near = 1e-6 * (self.high[t] - self.low[t])
        inside = every[(every > low + near) & (every < high - near)]
        return np.concatenate([[low], inside, [high]])

    def slopes(
        self, t: int, values: Callable[[np.ndarray], np.ndarray], low: float, high: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """[rows, …] slopes above and below the rows, of `values` [n, …] known from low to high."""
        row = np.linspace(self.low[t], self.high[t], ROWS)
        part = (self.high[t] - self.low[t]) / (THIRD * PIECES)
        left = np.stack([row - part / 2, row - part / 2])
        if self.corners:
            left[:, ::2] = row[::2], row[::2] - part
        width = min(part, high - low)
        left = np.clip(left, low, high - width)
        above, below = ((values(item + width) - values(item)) / width for item in left)
        return above, below


def slope_table(schedule) -> SlopeTable:
    """The rows of all days: on corners where they are few and known, else across each interval."""
    steps = schedule.steps
    low, high = np.asarray(steps.next_low, float), np.asarray(steps.next_high, float)
    across = SlopeTable(low, high, low, high, corners=False)
    volume = common_volume(steps)
    widest = np.max(high - low, initial=0.0)
    if volume is None or widest <= 0:
        return across
    step = volume / max(1, int(PIECES * volume / (widest + volume) + COMMON))
    first = low[-1] + np.floor((low - low[-1]) / step + COMMON) * step
    last = first + PIECES * step
    if np.any(last < high - COMMON * step):
        return across
    return SlopeTable(first, last, low, high, corners=True)


def common_volume(steps) -> float | None:
    """The volume of which all daily ones are multiples; None where they depend on the inventory."""
    volumes = np.concatenate([steps.injection_rate, steps.withdrawal_rate])
    if np.any(np.ptp(volumes, axis=1) > 0) or np.any(np.asarray(steps.inventory_loss) != 0):
        return None
    volumes = np.unique(volumes[volumes > 0])
    for part in range(1, DIVISORS + 1) if len(volumes) else ():
        volume = volumes[0] / part
        if np.all(np.abs(volumes - np.round(volumes / volume) * volume) <= COMMON * volume):
            return float(volume)
    return None
