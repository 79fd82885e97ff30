"""A line of places with normal demand that waits: the exact recursion of Clark and Scarf (1960).

C(j)(y) = E[h(j) x + c(j - 1)(x)], x = y - demand of L(j) periods, from the customer up;
S(j) = argmin C(j), c(j)(x) = C(j)(min(S(j), x)), c(0)(x) = (p + all h) max(-x, 0), with echelon
holding costs h. Snyder and Shen, Fundamentals of Supply Chain Theory, section 6.2. On a grid of
echelon positions, expectations by the mass between its points.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats


class SupplyLine(NamedTuple):
    """Echelon levels [n], from the customer up, and the cost of a period."""

    levels: np.ndarray
    cost: float


def serial_line(
    mean: float,
    deviation: float,
    holding: np.ndarray,
    periods: np.ndarray,
    shortage: float,
    width: float = 0.01,
) -> SupplyLine:
    """The best echelon levels, and the minimum average cost.

    - `holding` [n] local costs, `periods` [n] of demand between an order and its arrival, both from
      the customer up; goods on their way cost as much as at the place that sent them.
    - `width` of the grid, in units of demand.
    """
    echelon = np.asarray(holding) - np.append(np.asarray(holding)[1:], 0.0)
    complete = int(np.sum(periods))
    reach = 10 * deviation * np.sqrt(complete)
    grid = np.arange(-reach - complete * mean, complete * mean + reach, width)
    carried = (shortage + holding[0]) * np.maximum(-grid, 0)
    levels, cost = [], np.nan
    for h, length in zip(echelon, periods):
        local = h * grid + carried
        law = stats.norm(mean * length, deviation * np.sqrt(length))
        half = int(np.ceil((9 * law.std()) / width))
        centre = round(law.mean() / width)
        steps = np.arange(centre - half, centre + half + 1)
        mass = np.diff(law.cdf((np.append(steps, steps[-1] + 1) - 0.5) * width))
        expected = np.full(len(grid), np.inf)
        inner = np.convolve(local, mass, "valid")  # [i]: sum over k of local[i + K - 1 - k] mass[k]
        first = len(mass) - 1 + steps[0]
        expected[first : first + len(inner)] = inner[: len(grid) - first]
        best = int(np.argmin(expected))
        levels.append(grid[best])
        cost = float(expected[best])
        carried = expected[np.minimum(np.arange(len(grid)), best)]
        carried[:first] = inner[0] + (grid[:first] - grid[first]) * (inner[1] - inner[0]) / width
    return SupplyLine(np.array(levels), cost)
