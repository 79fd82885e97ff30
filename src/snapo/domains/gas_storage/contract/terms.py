"""The terms of a contract in the form in which they are used: in a simulator, and in a case at
fixed prices.

`NumbersOf` returns the numbers of an input on its days: with `CaseInput.used` for a case, and with
a `Use` of traced inputs in a simulator. The formulas are the same for both; nothing here uses JAX.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import NumbersOf
from snapo.problem.record.either import with_numpy

from .reachable import InventoryLimits, reachable
from .records import Contract, GasMarket, StorageCase

AnyArray = Any  # an array of NumPy, or of JAX in a simulator
_PER_DAY = (
    "injection_cost",
    "withdrawal_cost",
    "inventory_cost",
    "injection_fuel",
    "withdrawal_fuel",
)


class Day(NamedTuple):
    """One decision day, the same for all paths; every leaf has a leading axis T in the schedule.

    Prices are in currency per unit, volumes in units per day; discount factors are to the valuation
    date. `low`, `high` bound the inventory at the start of the day, `next_low`, `next_high` at its
    end. `price` is the row of the price process, `ahead` the shape of the curve for the network,
    `value_table` the marginal value of gas from which the policy starts, `hedge` the forward volume
    of the control variate, and `innovation` the fitted value of the other control variate.
    """

    day: AnyArray
    forward: AnyArray
    gas_discount: AnyArray
    flow_discount: AnyArray
    injection_cost: AnyArray
    withdrawal_cost: AnyArray
    injection_cost_discount: AnyArray
    withdrawal_cost_discount: AnyArray
    inventory_cost: AnyArray
    injection_fuel: AnyArray
    withdrawal_fuel: AnyArray
    inventory_loss: AnyArray
    levels: AnyArray
    withdrawal_rate: AnyArray
    injection_rate: AnyArray
    min_injection: AnyArray
    min_withdrawal: AnyArray
    low: AnyArray
    high: AnyArray
    next_low: AnyArray
    next_high: AnyArray
    price: Any = None
    ahead: Any = None
    value_table: Any = None
    hedge: Any = 0.0
    innovation: Any = None


class ContractTerms(NamedTuple):
    """The numbers of the whole contract: start, end and fixed costs.

    `end_levels`, `end_values` [M]: the value of the gas left, in addition to `end_fraction` times
    its value at the spot price; `fixed_costs` is a present value. `price` has the constants of the
    price process, `end_price` the row of this process on the end date. `price_scale` is the mean
    forward price, `rate_scale` the largest daily rate, and `innovation` the control variate of the
    end.
    """

    inventory: AnyArray
    end_levels: AnyArray
    end_values: AnyArray
    end_fraction: AnyArray
    end_forward: AnyArray
    end_discount: AnyArray
    fixed_costs: AnyArray
    last_day: AnyArray
    price: Any = None
    end_price: Any = None
    price_scale: Any = None
    rate_scale: Any = None
    innovation: Any = None


class KnownSchedule(NamedTuple):
    """The data that the methods of `references` read from a schedule whose prices are the forward
    prices."""

    constants: ContractTerms
    steps: Day


def inventory_limits(contract: Contract, at: NumbersOf) -> InventoryLimits:
    """The inventory limits, the rates after outages, the losses and the forced flows of each
    day."""
    rows = contract.ratchets
    return InventoryLimits(
        minimum=at(contract.min_inventory)[:-1],
        maximum=at(contract.max_inventory)[:-1],
        inventory_loss=at(contract.inventory_loss),
        levels=at(rows.inventory),
        withdrawal_rate=at(rows.withdrawal) * contract.withdrawal_factor[:, None],
        injection_rate=at(rows.injection) * contract.injection_factor[:, None],
        min_injection=at(contract.min_injection),
        min_withdrawal=at(contract.min_withdrawal),
    )


def end_interval(contract: Contract, at: NumbersOf) -> tuple[Any, Any]:
    """The inventories allowed on the end date."""
    low, high = (at(item)[-1] for item in (contract.min_inventory, contract.max_inventory))
    return contract.at_end.interval(at, low, high)


def per_day(
    contract: Contract, at: NumbersOf, limits: InventoryLimits, low: Any, high: Any
) -> dict:
    """The numbers of each `Day` that come from the contract; `low`, `high` [T + 1]: from
    `reachable`."""
    names = set(InventoryLimits._fields) & set(Day._fields)
    return {
        **{name: getattr(limits, name) for name in names},
        **{name: at(getattr(contract, name)) for name in _PER_DAY},
        "low": low[:-1],
        "high": high[:-1],
        "next_low": low[1:],
        "next_high": high[1:],
    }


def discount(market: GasMarket, days: np.ndarray) -> np.ndarray:
    """exp(-r(d) d / 365) for payments on integer days since the valuation date; 1 if d <= 0."""
    later = np.maximum(np.asarray(days, np.float64), 0)
    rates = np.interp(later, market.zero_rate_day, market.zero_rate.used())
    return np.exp(-rates * later / 365)


def fixed_costs_value(case: StorageCase) -> float:
    """The present value of the fixed costs that are still owed, in currency; it is to be subtracted
    from the value."""
    amounts = case.contract.fixed_costs.used()
    return float(np.sum(amounts * discount(case.market, case.contract.fixed_cost_day)))


@with_numpy
def known_schedule(case: StorageCase) -> KnownSchedule:
    """The schedule of a case at its forward prices, in NumPy, without the numbers of the price
    process.

    It equals the result of `StorageSimulator.prepare` for the inputs of the case up to rounding, if
    a decision day is left.
    """
    contract, market, at = case.contract, case.market, CaseInput.used
    limits, curve = inventory_limits(contract, at), market.forward_curve.used()
    low, high = reachable(limits, *end_interval(contract, at), contract.ratchets.interpolation)
    end = contract.at_end.terms(at)
    days = Day(
        day=case.day,
        forward=curve[: len(case.days)],
        gas_discount=discount(market, market.gas_day),
        flow_discount=discount(market, case.day),
        injection_cost_discount=discount(market, contract.injection_cost_day),
        withdrawal_cost_discount=discount(market, contract.withdrawal_cost_day),
        **per_day(contract, at, limits, low, high),
    )
    constants = ContractTerms(
        inventory=at(contract.inventory),
        end_levels=end.levels,
        end_values=end.values,
        end_fraction=end.fraction,
        end_forward=curve[-1],
        end_discount=discount(market, np.asarray(case.end_day)),
        fixed_costs=np.asarray(fixed_costs_value(case)),
        last_day=np.asarray(case.end_day),
    )
    return KnownSchedule(constants, days)


def value_without_decisions(case: StorageCase) -> float:
    """The value, before fixed costs, of a case with no decision days.

    It is zero after the end date; otherwise it is the discounted value of the inventory on the end
    date at the forward price. A required inventory is in store, since otherwise the case would have
    been refused.
    """
    if case.days:
        raise ValueError(f"{case.file}: {len(case.days)} decision days are left; this needs none.")
    if case.expired:
        return 0.0
    inventory = float(case.contract.inventory.used())
    factor = float(discount(case.market, np.array(case.end_day)))
    price = float(case.market.forward_curve.used()[-1]) if case.has_end_price else 0.0
    return factor * case.contract.at_end.value_known(inventory, price)
