"""The best flow of one day for many price states at once, exact or from above.

The value after the day is linear between nodes. The best flow to a node or to an end of the reach
is then exact at every start-of-day node. Between two nodes the value is convex but for its bends
(`DayGrid.buy_bends`): with one more gain there, a line between raised nodes lies above it all.
"""

import numpy as np

from ..references.day_terms import UnitPrices
from .day_grid import Bends, DayGrid, ReachableLevels


def best_value(day: DayGrid, prices: UnitPrices, after: np.ndarray, above: bool) -> np.ndarray:
    """The value at the start of the day [n, columns] of the best flow, from that at its end.

    **Arguments:**

    - `prices`: present values of a unit bought and sold, [columns] each.
    - `after` [m, columns]: the value on the day's last nodes, linear between them.
    - `above`: the result, linear between nodes, nowhere lies below the value of the best flow from
      there; otherwise it is that value at the nodes, and may lie below it in between.
    """
    keep = day.keep[:, None]
    buying = _less(after, day.after, prices.pay)
    selling = _less(after, day.after, prices.earn)
    value = _best_within(buying, day.buy, len(keep))
    value += keep * prices.pay
    other = _best_within(selling, day.sell, len(keep))
    other += keep * prices.earn
    np.maximum(value, other, out=value)
    if above:
        excess = np.zeros((len(keep) - 1, after.shape[1]))
        _exceed(excess, value, buying, prices.pay, day.buy_bends)
        _exceed(excess, value, selling, prices.earn, day.sell_bends)
        # A node serves two cells, and is raised by what the needier one lacks.
        if len(excess):
            value[0] += excess[0]
            value[-1] += excess[-1]
            value[1:-1] += np.maximum(excess[:-1], excess[1:])
    if day.cost.any():
        value -= day.cost[:, None]
    return value


def _less(after: np.ndarray, nodes: np.ndarray, price: np.ndarray) -> np.ndarray:
    """The value after the day less the worth of the gas at a price: [m, columns]."""
    value = np.multiply.outer(nodes, price)
    return np.subtract(after, value, out=value)


def _best_within(line: np.ndarray, reach: ReachableLevels, rows: int) -> np.ndarray:
    """[rows, columns] the most of a line, given on nodes and linear between them, within reach."""
    best = np.full((rows, line.shape[1]), -np.inf)
    levels = [line]
    for k, selected, first, last in reach.inside:
        while len(levels) <= k:
            wide, step = levels[-1], 1 << (len(levels) - 1)
            levels.append(np.maximum(wide[:-step], wide[step:]))
        best[selected] = np.maximum(levels[k][first], levels[k][last]) if k else line[first]
    for selected, left, right, share in reach.endpoints:
        result = line[right] - line[left]
        result *= share
        result += line[left]
        best[selected] = np.maximum(best[selected], result)
    return best


def _exceed(excess, value, line, price, bends: Bends | None) -> None:
    """The most by which a bend of a cell lies above the chord of `value`, into `excess`."""
    if bends is None:
        return
    reduceat = value[bends.left] - value[bends.right]
    reduceat *= bends.share
    reduceat -= value[bends.left]
    reduceat += line[bends.target]
    reduceat += bends.keep * price
    if bends.starts is not None:
        reduceat = np.maximum.reduceat(reduceat, bends.starts, axis=0)
    excess[bends.cells] = np.maximum(excess[bends.cells], reduceat)
