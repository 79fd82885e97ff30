"""Rules of thumb for one item: initial values of a rule, and the expected cost of a period."""

from collections.abc import Callable
from typing import Any

import numpy as np

from snapo.problem.record.either import xp

from .records import InventoryCase


def mean_demand(case: InventoryCase) -> float:
    """The mean demand of a period, over the season."""
    return case.demand.values()["demand_mean"] * float(case.season.values.mean())


def usual_deviation(case: InventoryCase) -> float:
    """The standard deviation of a period's demand, over the season."""
    return float(np.mean(case.demand.deviation(case.demand.values(), case.season.values)))


def safety_factor(case: InventoryCase, quantile: Callable[[float], float] | None = None) -> float:
    """The initial base-stock level minus the mean demand of L + 1 periods, in standard deviations.
    It is the newsvendor's quantile for p / (p + h). For lost sales it is the quantile for p / (p +
    (L + 1) h), as if demand waited at a shortage cost of p / (L + 1), which costs less than lost
    demand (Janakiraman, Seshadri and Shanthikumar, Operations Research 55, 2007). Training starts
    from this number. `quantile`: the quantile function of the standard normal distribution, by
    default SciPy's.
    """
    item = case.item
    holding = item.cost("holding") * (item.lead_time + 1 if item.lost else 1)
    ratio = item.cost("shortage") / (item.cost("shortage") + holding)
    return float(np.clip((quantile or _quantile)(ratio), -1.0, 4.0))


def base_stock(mean: Any, deviation: Any, safety: Any) -> Any:
    """[T] the initial levels: `safety` standard deviations above the mean of the demand of
    L + 1 periods; `mean`, `deviation` [T, L + 1]: mean and standard deviation of the demand in each
    of these periods."""
    return xp.sum(mean, 1) + safety * xp.sqrt(xp.sum(deviation**2, 1))


def season_ahead(factors: Any, periods: int, lead_time: int) -> Any:
    """[T, L + 1] the factors of demand from each period until an order placed in it arrives."""
    ahead = np.add.outer(np.arange(periods), np.arange(lead_time + 1))
    return factors[ahead % len(factors)]


def _quantile(share: float) -> float:
    from scipy.special import ndtri  # late: cases are checked without it

    return float(ndtri(share))


def density_at(share: float) -> float:
    """The standard normal density at the quantile of this probability."""
    return float(np.exp(-(_quantile(share) ** 2) / 2) / np.sqrt(2 * np.pi))


def economic_lot(case: InventoryCase) -> float:
    """sqrt(2 K mean (p + h) / (h p)): the optimal order size for constant demand (Harris; Camp)."""
    item = case.item
    holding, shortage = item.cost("holding"), item.cost("shortage")
    more = (shortage + holding) / (holding * shortage)
    return float(np.sqrt(2 * item.cost("ordering") * mean_demand(case) * more))


def usual_cost(case: InventoryCase) -> float:
    """An estimate of the cost of a period: the costs of economic lots and of a newsvendor's safety
    stock, added in quadrature, plus purchases. In three cases its error is 2 to 11 % of the cost of
    the optimal (s, S) rule."""
    item, periods = case.item, case.item.lead_time + 1
    holding, shortage = item.cost("holding"), item.cost("shortage")
    lots = economic_lot(case) * holding * shortage / (holding + shortage)
    density = density_at(shortage / (shortage + holding))
    safety = (holding + shortage) * density * np.sqrt(periods) * usual_deviation(case)
    return float(np.hypot(lots, safety)) + item.cost("purchase") * mean_demand(case)


def memory(case: InventoryCase) -> float:
    """The number of periods after which an order has no effect: 20 times the sum of its lead time
    and the periods of a lot. In one case with a cost of 12.9, the derivative with respect to the
    threshold of ordering is -0.06 per standard deviation; its error is 0.02 with the factor 20 and
    0.04 with the factor 10.
    """
    return 20 * (case.item.lead_time + 1 + economic_lot(case) / mean_demand(case))
