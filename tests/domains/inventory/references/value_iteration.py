"""The least average cost of one item with whole demand and whole orders, by value iteration.

Exact up to its tolerance and the two limits given: relative value iteration on the stock and the
orders on their way, with MacQueen's bounds (1966) around the average cost. Demand is lost or
delivered later where there is no stock; timing as in `snapo.domains.inventory.item.simulator`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Costs(NamedTuple):
    """Costs of a period: per unit held, per unit short, per unit ordered, and per order."""

    holding: float
    shortage: float
    purchase: float = 0.0
    order: float = 0.0


class ExactOptimum(NamedTuple):
    """The minimum average cost of a period, between `low` and `high`, and the best orders.

    - `orders`: by stock [0 …] and the orders on their way, the next one to arrive first; of
      backlogged demand by inventory position, from `first`.
    """

    low: float
    high: float
    orders: np.ndarray
    first: int = 0

    @property
    def cost(self) -> float:
        """The middle of both bounds."""
        return (self.low + self.high) / 2


def lost_sales(
    probabilities: Float[np.ndarray, " demands"],
    mean: float,
    costs: Costs,
    lead_time: int,
    most_stock: int,
    most_order: int,
    tolerance: float = 1e-6,
) -> ExactOptimum:
    """Unmet demand is lost; the shortage cost is of every unit lost.

    - `probabilities`: of demands 0, 1, …; `mean`: of the whole distribution, its tail included.
    - `lead_time`: periods from an order to its arrival, 0 or more.
    - `most_stock`, `most_order`: limits of the grid; they must not bind at the optimum.
    """
    moves, idle = _period(probabilities, mean, costs, most_stock)
    paid = costs.purchase * np.arange(most_order + 1) + costs.order * (
        np.arange(most_order + 1) > 0
    )
    arrives = np.minimum(
        np.add.outer(np.arange(most_stock + 1), np.arange(most_order + 1)), most_stock
    )

    def future_cost(value: np.ndarray) -> np.ndarray:
        """[state …, order]: cost from here on, where `value` is that of the next period."""
        if lead_time == 0:
            return (idle + moves @ value)[arrives] + paid
        after = value[arrives]
        # [stock left, the next arrival, …, the order]: a lead of 1 adds the order itself.
        flat = moves @ after.reshape(most_stock + 1, -1)
        return flat.reshape(after.shape) + idle.reshape(-1, *[1] * (after.ndim - 1)) + paid

    shape = (most_stock + 1, *[most_order + 1] * max(lead_time - 1, 0))
    return _iterate(future_cost, np.zeros(shape), tolerance)


def backlogged(
    probabilities: Float[np.ndarray, " demands"],
    mean: float,
    costs: Costs,
    lead_time: int,
    minimum: int,
    maximum: int,
    tolerance: float = 1e-6,
) -> ExactOptimum:
    """Unmet demand waits; the shortage cost is of every unit that waits, every period.

    The state is the inventory position before the order, `minimum` to `maximum`: an order now is
    felt in the period in which it is on hand, after the demand of the periods until then.
    """
    levels = np.arange(minimum, maximum + 1)
    felt = np.array([1.0])
    for _ in range(lead_time + 1):
        felt = np.convolve(felt, probabilities)
    demands = np.arange(len(felt))
    left = np.maximum(np.subtract.outer(levels, demands), 0) @ felt
    expected = costs.holding * left + costs.shortage * (left - levels + mean * (lead_time + 1))
    position = np.clip(
        np.subtract.outer(levels, np.arange(len(probabilities))) - minimum, 0, len(levels) - 1
    )
    more = np.subtract.outer(-levels, -levels)  # [from, to]
    paid = np.where(more >= 0, costs.purchase * more + costs.order * (more > 0), np.inf)

    def future_cost(value: np.ndarray) -> np.ndarray:
        return (expected + value[position] @ probabilities) + paid

    iterate = _iterate(future_cost, np.zeros(len(levels)), tolerance)
    return iterate._replace(orders=iterate.orders - np.arange(len(levels)), first=minimum)


def _period(probabilities, mean: float, costs: Costs, most_stock: int):
    """[stock, stock left] transitions, and the expected cost [stock] of a period."""
    moves = np.zeros((most_stock + 1, most_stock + 1))
    for stock in range(1, most_stock + 1):
        met = probabilities[: min(stock, len(probabilities))]
        moves[stock, stock - np.arange(len(met))] = met
    moves[:, 0] += 1 - moves.sum(1)
    stocks = np.arange(most_stock + 1)
    left = moves @ stocks
    return moves, costs.holding * left + costs.shortage * (mean - stocks + left)


def _iterate(values, value: np.ndarray, tolerance: float, maximum: int = 20_000) -> ExactOptimum:
    """Relative value iteration until both bounds are within `tolerance`."""
    for _ in range(maximum):
        every = values(value)
        after = every.min(-1)
        change = after - value
        low, high = float(change.min()), float(change.max())
        if high - low < tolerance:
            return ExactOptimum(low, high, every.argmin(-1))
        value = after - after.flat[0]
    raise ValueError(f"value iteration: {high - low:g} are left after {maximum} rounds.")  # pyright: ignore
