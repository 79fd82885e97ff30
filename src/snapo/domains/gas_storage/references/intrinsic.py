"""The intrinsic value: the best plan of trades at today's forward curve, without noise."""

from typing import NamedTuple

import numpy as np

from .day_terms import Interpolation, UnitPrices, end_value, unit_prices
from .piecewise import PiecewiseLine, best_move, day_value, visited


class IntrinsicPlan(NamedTuple):
    """A plan of trades, fixed today.

    - `value`: present value on the valuation date, in the currency of the contract.
    - `net`: net volume injected on each day, negative for withdrawals, [T].
    - `inventory`: gas in store at the start of each day, and on the end date, [T + 1].
    """

    value: float
    net: np.ndarray
    inventory: np.ndarray


def intrinsic(schedule, interpolation: Interpolation) -> IntrinsicPlan:
    """The exact intrinsic value with free volumes, by piecewise-linear dynamic programming.

    It is exact up to rounding for every contract: with linear or step ratchets of any shape, and
    any value at the end. It needs no grid, see `piecewise`. For concave contracts it is tested
    against a linear program.
    """
    low, high = visited(schedule, interpolation)
    after = values_after(schedule, interpolation, low, high)
    inventory = np.empty(len(after) + 1)
    inventory[0] = schedule.constants.inventory
    for t, line in enumerate(after):
        prices = forward_prices(schedule, t)
        inventory[t + 1] = best_move(schedule, interpolation, t, prices, line, inventory[t])
    return plan(schedule, inventory)


def values_after(schedule, interpolation: Interpolation, low, high) -> list[PiecewiseLine]:
    """The value of gas at the END of each day, if all prices are today's forward prices.

    The values are present values, exact on [low[t + 1], high[t + 1]] of the T + 1 supplied
    intervals.
    """
    horizon = len(schedule.steps.forward)
    line = _end_line(schedule, low[horizon], high[horizon])
    after = [line] * horizon
    for t in reversed(range(horizon)):
        after[t] = line
        prices = forward_prices(schedule, t)
        line = day_value(schedule, interpolation, t, prices, line, low[t], high[t])
    return after


def forward_prices(schedule, t: int) -> UnitPrices:
    """The cost and the proceeds of a unit on day t at the forward price."""
    return unit_prices(schedule, t, schedule.steps.forward[t])


def _end_line(schedule, low: float, high: float) -> PiecewiseLine:
    levels = schedule.constants.end_levels
    inside = levels[(levels > low) & (levels < high)]
    # Without indices NumPy loads its masked arrays.
    at = np.unique(np.concatenate([[low], inside, [high]]), return_index=True)[0]
    return PiecewiseLine(at, end_value(schedule, at, schedule.constants.end_forward))


def plan(schedule, inventory: np.ndarray) -> IntrinsicPlan:
    """The value and the net volumes of a plan at the forward curve; the plan is the inventories [T
    + 1]."""
    steps = schedule.steps
    net = inventory[1:] - inventory[:-1] * (1 - steps.inventory_loss)
    value = end_value(schedule, inventory[-1:], schedule.constants.end_forward)[0]
    for t, volume in enumerate(net):
        prices = forward_prices(schedule, t)
        value -= volume * (prices.pay if volume > 0 else prices.earn)
        value -= steps.inventory_cost[t] * steps.flow_discount[t] * inventory[t]
    return IntrinsicPlan(float(value), net, inventory)
