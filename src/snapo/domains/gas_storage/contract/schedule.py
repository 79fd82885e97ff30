"""The numbers of a storage problem that all paths share, and the state of one path."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from snapo.problem.simulator import Schedule


class Day(NamedTuple):
    """One decision day, the same for all paths; every leaf has a leading axis T in the schedule.

    Prices in currency per unit, volumes in units per day, discount factors to the valuation date.
    `low`, `high` bound the inventory at the start of the day, `next_low`, `next_high` at its end.
    `price` is the row of the price process, `ahead` tells the curve's shape to the network,
    `guide` holds the marginal value of gas that the policy starts from, `hedge` the forward volume
    of the control variate, `surprise` the fitted value of the other one.
    """

    day: Array
    forward: Array
    gas_discount: Array
    flow_discount: Array
    injection_cost: Array
    withdrawal_cost: Array
    injection_cost_discount: Array
    withdrawal_cost_discount: Array
    inventory_cost: Array
    injection_fuel: Array
    withdrawal_fuel: Array
    inventory_loss: Array
    levels: Array
    withdrawal_rate: Array
    injection_rate: Array
    min_injection: Array
    min_withdrawal: Array
    low: Array
    high: Array
    next_low: Array
    next_high: Array
    price: PyTree
    ahead: Array
    guide: Any = None
    hedge: Any = 0.0
    surprise: Any = None


class Terms(NamedTuple):
    """Numbers of the whole contract: start, end and fixed costs.

    `end_levels`, `end_values` [M]: currency for the gas left, on top of `end_fraction` of its
    spot value; `fixed_costs` is a present value. `price` holds the constants of the price process,
    `end_price` its row of the end date. `price_scale` is the mean forward price, `rate_scale` the
    largest daily rate, `surprise` the end of its control variate.
    """

    inventory: Array
    end_levels: Array
    end_values: Array
    end_fraction: Array
    end_forward: Array
    end_discount: Array
    fixed_costs: Array
    last_day: Array
    price: PyTree
    end_price: PyTree
    price_scale: Array
    rate_scale: Array
    surprise: Any = None


class State(NamedTuple):
    """Inventory at the start of the day, and the state of the price process on that day."""

    inventory: Float[Array, ""]
    price: PyTree


class Flows(NamedTuple):
    """The net flow that a day must have (`base`), and the bounds of the one that it may have.

    `keep` is the inventory left without any flow.
    """

    keep: Array
    base: Array
    most: Array
    least: Array


def of_prices(schedule: Schedule) -> Schedule:
    """The price process's own schedule, T + 1 rows of NumPy, out of that of the whole problem."""
    days, last = schedule.steps.price, schedule.constants.end_price
    rows = jax.tree.map(lambda leaf, end: np.concatenate([leaf, np.asarray(end)[None]]), days, last)
    return Schedule(schedule.constants.price, rows)
