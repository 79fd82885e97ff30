"""The worth of a contract without a decision left, and the costs that it owes in any case."""

import numpy as np

from .records import Market, StorageCase


def discount(market: Market, days: np.ndarray) -> np.ndarray:
    """exp(-r(d) d / 365) for payments on integer days since the valuation date; 1 where d <= 0."""
    later = np.maximum(np.asarray(days, np.float64), 0)
    rates = np.interp(later, market.zero_rate_day, market.zero_rate.used())
    return np.exp(-rates * later / 365)


def value_without_decisions(case: StorageCase) -> float:
    """The value, before fixed costs, of a case with no decision days.

    Zero after the end date; else that of the inventory on the end date, discounted from it: its
    level is met (or the case would have been refused), and its price is the forward price.
    """
    if case.days:
        raise ValueError(f"{case.file}: {len(case.days)} decision days are left.")
    if case.expired:
        return 0.0
    inventory = float(case.contract.inventory.used())
    factor = float(discount(case.market, np.array(case.end_day)))
    price = float(case.market.forward_curve.used()[-1]) if case.has_end_price else 0.0
    return factor * case.contract.at_end.known(inventory, price)


def fixed_costs_value(case: StorageCase) -> float:
    """The present value of the fixed costs still owed, in currency; to be taken off the value."""
    amounts = case.contract.fixed_costs.used()
    return float(np.sum(amounts * discount(case.market, case.contract.fixed_cost_day)))
