"""Rules of thumb for a network: initial values of rules, and the expected cost of a period at every
place."""

import numpy as np
from scipy.special import ndtri

from ..demand.base import MEAN
from ..item.estimates import density_at
from .records import NetworkCase


def safety_factors(case: NetworkCase) -> np.ndarray:
    """[n] the initial echelon levels minus the mean demand, in standard deviations: the average of
    two newsvendor quantiles. Shang and Song, Management Science 49 (2003): with echelon holding
    costs h, and with u the sum of h upstream of a place, these are the standard normal quantiles of
    (p + u) / (p + all h) and of (p + u) / (p + h + u).
    """
    averages = []
    for i in range(len(case.network.sites)):
        p, local = _costs_below(case, i)
        up = _above(case, i)
        holding = float(case.holding.values[i])
        ratios = (p + up) / (p + local), (p + up) / (p + max(holding, up))
        averages.append(np.mean([ndtri(min(ratio, 0.9999)) for ratio in ratios]))
    return np.clip(averages, -1.0, 4.0)


def _costs_below(case: NetworkCase, i: int) -> tuple[float, float]:
    """Mean shortage cost and mean local holding cost of the places with customers that a place
    supplies."""
    reached = [k for k, j in enumerate(case.network.sellers) if case.network.serves[i, j]]
    holding = [case.holding.values[case.network.sellers[k]] for k in reached]
    return float(np.mean(case.shortage.values[reached])), float(np.mean(holding))


def _above(case: NetworkCase, i: int) -> float:
    """The holding cost of the supplier, 0 for supply from outside."""
    supplier = case.network.sites[i].supplier
    return float(case.holding.values[supplier]) if supplier is not None else 0.0


def served(case: NetworkCase) -> tuple[np.ndarray, np.ndarray]:
    """[n] mean and standard deviation, over the season, of the demand in a period that a place
    serves."""
    reach = case.network.serves[:, case.network.sellers]
    means, spreads = [], []
    for demand, season in zip(case.demands, case.seasons):
        local = demand.values()
        factors = np.ones(1) if season is None else season.values
        means.append(local[MEAN] * float(factors.mean()))
        spreads.append(float(np.mean(demand.deviation(local, factors))))
    return reach @ np.array(means), np.sqrt(reach @ np.array(spreads) ** 2)


def economic_lots(case: NetworkCase) -> np.ndarray:
    """[n] sqrt(2 K mean (p + h) / (e p)), 0 if an order has no fixed cost.

    Here h is the local holding cost of the places with customers. The echelon holding cost e is the
    additional cost of holding a unit at the place instead of at its supplier. A single place has
    the economic lot of an item.
    """
    lots, (mean, _) = np.zeros(len(case.network.sites)), served(case)
    for i, cost in zip(case.network.fixed, _ordering(case)):
        p, local = _costs_below(case, i)
        lots[i] = np.sqrt(2 * cost * mean[i] * (p + local) / (_echelon_cost(case, i) * p))
    return lots


def _ordering(case: NetworkCase) -> np.ndarray:
    return np.zeros(0) if case.ordering is None else case.ordering.values


def _echelon_cost(case: NetworkCase, i: int) -> float:
    local = float(case.holding.values[i])
    return max(local - _above(case, i), local / 10)


def first_batches(case: NetworkCase) -> tuple[np.ndarray, np.ndarray]:
    """The distance of S above the first level, [n], and of s below it, [m], in standard deviations.
    Without a fixed cost the distance of S is 0 and there is no s. With a lot Q, stock runs short in
    the share e Q / ((p + u) mean + e Q) of its cycles, where u is the holding cost of the supplier.
    When an order is placed, the position is on average half a period's demand below the reorder
    point.
    """
    (mean, unit), lots = served(case), economic_lots(case)
    batch, wait = np.zeros(len(case.network.sites)), np.zeros(len(case.network.fixed))
    safety = safety_factors(case)
    for k, i in enumerate(case.network.fixed):
        p = _costs_below(case, i)[0] + _above(case, i)
        held = _echelon_cost(case, i) * lots[i]
        factor = float(ndtri(1 - held / (p * mean[i] + held)))
        below = (safety[i] - factor) * np.sqrt(case.network.cover[i]) * unit[i]
        wait[k] = (below + mean[i] / 2) / unit[i]
        batch[i] = (lots[i] - below - mean[i]) / unit[i]
    return batch, wait


def usual_costs(case: NetworkCase) -> np.ndarray:
    """[n] estimates of the costs of a period at each place; the deviations from them cause the
    noise of training. A place with customers has the costs of an item: the costs of economic lots
    and of a newsvendor's safety stock, added in quadrature. Any other place has the costs of its
    orders, and of its stock and the goods on their way at its initial levels.
    """
    (mean, unit), lots = served(case), economic_lots(case)
    batch, wait = first_batches(case)
    middle = _usual_levels(case) + unit * batch / 2
    middle[list(case.network.fixed)] -= unit[list(case.network.fixed)] * wait / 2
    lead_time = np.array([site.lead_time for site in case.network.sites])
    selected = case.holding.values * np.maximum(
        middle - lead_time * mean - case.network.supplies @ middle, 0.0
    )
    for i, cost in zip(case.network.fixed, _ordering(case)):
        selected[i] += cost * mean[i] / lots[i]
    for i in case.network.sellers:
        p, h = _costs_below(case, i)
        safety = (h + p) * density_at(p / (p + h)) * np.sqrt(lead_time[i] + 1) * unit[i]
        selected[i] = np.hypot(lots[i] * h * p / (h + p), safety)
    return selected


def _usual_levels(case: NetworkCase) -> np.ndarray:
    """[n] the means of the first echelon levels over the season."""
    mean, unit = served(case)
    return case.network.cover * mean + safety_factors(case) * unit * np.sqrt(case.network.cover)


def memory(case: NetworkCase) -> np.ndarray:
    """[m] the number of periods after which an order no longer has an effect: twenty times the
    periods of a lot, plus the periods until the order reaches the last customer. See
    `item.estimates.memory`."""
    lots, (mean, _), sites = economic_lots(case), served(case), list(case.network.fixed)
    return 20 * (case.network.cover[sites] + lots[sites] / mean[sites])
