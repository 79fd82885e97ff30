"""Stores that share their stocks: the minimum cost for normal demand that waits, in closed form.

Orders arrive before demand (lead time 0), so every period starts at the levels S_i, and after
demand goods go wherever they are short. With D_i independent, and equal costs, the final stock is
(sum S - sum D)^+, the shortage (sum D - sum S)^+, and the amount moved is the sum of (S_i - D_i)^+
less the final stock:

    cost = h E(S - D)^+ + p E(D - S)^+ + c (sum E(S_i - D_i)^+ - E(S - D)^+),     c <= h + p.

Krishnan and Rao, Journal of Industrial Engineering 16 (1965). With c = 0 it is the newsvendor of
the total demand (Eppen, Management Science 25, 1979), with c = h + p one newsvendor for each store.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize, stats


class Pooled(NamedTuple):
    """The least cost of a period, and the levels [n] that have it."""

    cost: float
    levels: np.ndarray


def pooled_stores(
    mean: np.ndarray, deviation: np.ndarray, holding: float, shortage: float, moving: float
) -> Pooled:
    """Stores with these means and standard deviations [n] of demand."""
    mean, deviation = np.asarray(mean, np.float64), np.asarray(deviation, np.float64)
    total = float(np.sqrt(np.sum(deviation**2)))

    def cost(levels: np.ndarray) -> float:
        over = levels.sum() - mean.sum()
        held = _positive_part(over, total)
        moved = float(np.sum(_positive_part(levels - mean, deviation))) - held
        return holding * held + shortage * (held - over) + moving * moved

    # The levels of each store by itself, from which pooling goes down.
    start = mean + stats.norm.ppf(shortage / (shortage + holding)) * deviation
    minimize = optimize.minimize(cost, start, method="BFGS", options={"gtol": 1e-7})
    return Pooled(float(minimize.fun), np.asarray(minimize.x))


def one_newsvendor(deviation: float, holding: float, shortage: float) -> float:
    """(h + p) phi(z) deviation: the cost of a level for demand of this deviation.

    For n equal stores with a lead time of L periods, pooled at no cost, the deviation is that of
    all demand in L + 1 periods. Balanced at no cost before demand only, each store faces sqrt(L / n
    + 1) deviations of a period (Eppen and Schrage, 1981), provided that balance never needs stock
    which the others cannot spare.
    """
    z = stats.norm.ppf(shortage / (shortage + holding))
    return float((holding + shortage) * stats.norm.pdf(z) * deviation)


def _positive_part(mean, deviation):
    """E(X)^+ of a normal X."""
    ratio = mean / deviation
    return deviation * (stats.norm.pdf(ratio) + ratio * stats.norm.cdf(ratio))
