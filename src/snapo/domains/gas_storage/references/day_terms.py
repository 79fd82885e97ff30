"""One decision day for dynamic programs: feasible volumes and their cost.

Everything here is plain NumPy in float64 and reads the prepared schedule with NumPy leaves. All
money is a present value on the valuation date, all volumes are in the unit of the contract. Columns
(the last axis) are nodes of the price factors, or price paths.
"""

from typing import Literal, NamedTuple

import numpy as np

Interpolation = Literal["linear", "step"]

# Widths below this fraction of the largest inventory count as one point.
POINT = 1e-9


class DayRates(NamedTuple):
    """The rate limits of one day: linear between rising inventory levels, and constant outside
    them. [K]"""

    levels: np.ndarray
    withdrawal: np.ndarray
    injection: np.ndarray


class FlowChoices(NamedTuple):
    """The inventories at the end of the day that can be reached from each inventory at its start.
    [n]

    `keep` is the inventory without any flow (after losses), `down` and `up` the smallest and the
    largest inventory that the contract allows, and `hold` the allowed inventory nearest to `keep`.
    """

    keep: np.ndarray
    down: np.ndarray
    hold: np.ndarray
    up: np.ndarray


class UnitPrices(NamedTuple):
    """The present value that a unit injected costs, and that a unit withdrawn earns. [columns]"""

    pay: np.ndarray
    earn: np.ndarray


def volume_scale(schedule) -> float:
    """The largest inventory that any day allows, as the scale of tolerances on volumes."""
    steps = schedule.steps
    return float(max(np.max(steps.high, initial=0.0), np.max(steps.next_high, initial=0.0), 1e-300))


def rates(schedule, interpolation: Interpolation, t: int) -> DayRates:
    """The ratchets of a day as continuous piecewise-linear functions of the inventory.

    With step ratchets (the row at or below the inventory applies) a jump at a level becomes a ramp
    that ends at the level, with a width of 1e-9 of the largest inventory. A dynamic program then
    needs only one kind of function, and can gain at most that volume from the ramp.
    """
    steps = schedule.steps
    levels, first = np.unique(steps.levels[t], return_index=True)
    withdrawal, injection = steps.withdrawal_rate[t][first], steps.injection_rate[t][first]
    if interpolation == "linear" or len(levels) == 1:
        return DayRates(levels, withdrawal, injection)
    ramp = POINT * volume_scale(schedule)
    knots = np.append(levels[0], np.stack([levels[1:] - ramp, levels[1:]], axis=1))
    row = np.arange(len(knots)) // 2
    return DayRates(knots, withdrawal[row], injection[row])


def flow_ends(
    schedule, day_rates: DayRates, t: int, inventory: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(keep, down, up): inventories [n] after losses, and after the smallest and largest flow.

    Only the rates and the forced flows apply; the inventory limits of the next day are ignored.
    """
    steps = schedule.steps
    keep = inventory * (1 - steps.inventory_loss[t])
    most_out = np.interp(inventory, day_rates.levels, day_rates.withdrawal)
    most_in = np.interp(inventory, day_rates.levels, day_rates.injection)
    minimum = steps.min_injection[t] if steps.min_injection[t] > 0 else -most_out
    maximum = -steps.min_withdrawal[t] if steps.min_withdrawal[t] > 0 else most_in
    return keep, keep + minimum, keep + maximum


def moves(schedule, day_rates: DayRates, t: int, inventory: np.ndarray) -> FlowChoices:
    """The inventories that can be reached at the end of day t from the inventories at its start
    [n].

    Source: rates are read at the start of the day; end = start (1 - loss) + in - out.
    """
    steps = schedule.steps
    keep, down, up = flow_ends(schedule, day_rates, t, inventory)
    down = np.clip(down, steps.next_low[t], steps.next_high[t])
    up = np.clip(up, steps.next_low[t], steps.next_high[t])
    up = np.maximum(up, down)
    return FlowChoices(keep, down, np.clip(keep, down, up), up)


def unit_prices(schedule, t: int, spot: np.ndarray) -> UnitPrices:
    """The unit prices: a withdrawal of q earns q (1 - fuel) S, an injection of q pays q (1 + fuel)
    S, and both pay their cost."""
    steps = schedule.steps
    gas = spot * steps.gas_discount[t]
    pay = gas * (1 + steps.injection_fuel[t])
    earn = gas * (1 - steps.withdrawal_fuel[t])
    return UnitPrices(
        pay + steps.injection_cost[t] * steps.injection_cost_discount[t],
        earn - steps.withdrawal_cost[t] * steps.withdrawal_cost_discount[t],
    )


def holding_cost(schedule, t: int, inventory: np.ndarray) -> np.ndarray:
    """The present value of the cost of keeping the inventory [n] at the start of day t for that
    day. [n]"""
    steps = schedule.steps
    return steps.inventory_cost[t] * steps.flow_discount[t] * inventory


def end_value(schedule, inventory: np.ndarray, spot) -> np.ndarray:
    """The present value of the gas left on the end date, at the spot price of that day.

    `inventory` and `spot` are broadcast against each other. Both parts of the rule of the contract
    are paid on the end date.
    """
    constants = schedule.constants
    levels, first = np.unique(constants.end_levels, return_index=True)
    table = np.interp(inventory, levels, constants.end_values[first])
    return (table + constants.end_fraction * inventory * spot) * constants.end_discount


def cash(prices: UnitPrices, net: np.ndarray) -> np.ndarray:
    """The present value that net injections [n] earn (withdrawals are negative). [n, columns]"""
    injected, withdrawn = np.maximum(net, 0.0), np.maximum(-net, 0.0)
    return withdrawn[:, None] * prices.earn - injected[:, None] * prices.pay
