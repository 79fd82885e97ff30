"""Demand that waits, normal and independent: the best base-stock level and its cost in closed form.

Zipkin, Foundations of Inventory Management (2000), section 6.5.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats


class BaseStockResult(NamedTuple):
    """The level up to which the inventory position is raised, and the cost of a period."""

    level: float
    cost: float


def best_base_stock(
    mean: float, deviation: float, lead_time: int, holding: float, shortage: float
) -> BaseStockResult:
    """S = (L + 1) mean + z s with s = deviation sqrt(L + 1); cost (h + p) phi(z) s.

    `holding` by unit and period, `shortage` by unit that waits and period; z is the normal
    quantile of p / (p + h). The timing is that of `snapo.domains.inventory.item.simulator`.
    """
    z = float(stats.norm.ppf(shortage / (shortage + holding)))
    spread = deviation * np.sqrt(lead_time + 1)
    cost = (holding + shortage) * float(stats.norm.pdf(z)) * spread
    return BaseStockResult((lead_time + 1) * mean + z * spread, float(cost))


def base_stock_cost(
    level: float, mean: float, deviation: float, lead_time: int, holding: float, shortage: float
) -> float:
    """The cost of a period at any level: h E(S - D)+ + p E(D - S)+, D of L + 1 periods."""
    spread = deviation * np.sqrt(lead_time + 1)
    z = (level - (lead_time + 1) * mean) / spread
    left = spread * (z * stats.norm.cdf(z) + stats.norm.pdf(z))
    return float(holding * left + shortage * (left - spread * z))
