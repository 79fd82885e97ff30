"""Reads `[contract]`: limits, rates, forced flows, costs and the end, each number on its days."""

import datetime
from collections.abc import Sequence

import numpy as np

from snapo.case.csv import Mention, read_rows
from snapo.case.dates import dated, ordinals, single
from snapo.case.given import Given
from snapo.case.table import Section

from .limits import Limits
from .records import Contract, EndRule, LevelAtEnd, PriceAtEnd, ValueAtEnd
from .settlement import payment_days
from .tables import ContractTable

# Fuel and losses take less than everything.
ALMOST_ONE = float(np.nextafter(1.0, 0.0))


def decision_days(table: ContractTable, valuation: datetime.date) -> tuple[datetime.date, ...]:
    """The days on which the contract may still act, seen from the valuation date."""
    wait = 1 if table.first_decision == "next-day" else 0
    first = max(table.start, valuation + datetime.timedelta(wait))
    return tuple(first + datetime.timedelta(n) for n in range((table.end - first).days))


def pays_by_price(table: ContractTable) -> bool:
    """Whether gas left on the end date is worth something by that day's price."""
    value = table.end_value
    return table.end_inventory == "free" and isinstance(value, float | int) and value != 0


def read_contract(
    section: Section,
    table: ContractTable,
    days: Sequence[datetime.date],
    valuation: datetime.date,
    limits: Limits,
    gas_day: np.ndarray,
) -> Contract:
    """The contract on its decision days [T], and on the end date where limits are concerned."""
    volume, money = table.volume_unit, table.currency
    price, rate = f"{money}/{volume}", f"{volume}/day"

    def daily(key: str, unit: str, low=-np.inf, high=np.inf):
        given = getattr(table, key)
        return dated(section, key, given, unit, days, low=low, high=high, before=0.0)

    amounts, amount_days = _read_fixed_costs(section, table, valuation)
    paid = {
        key: payment_days(
            section, key, getattr(table, key), days, valuation, limits.moving(), gas_day
        )
        for key in ("injection_cost_settlement", "withdrawal_cost_settlement")
    }
    return Contract(
        inventory=single("inventory", table.inventory, volume),
        min_inventory=limits.min_inventory,
        max_inventory=limits.max_inventory,
        ratchets=limits.ratchets,
        injection_factor=limits.injection_factor,
        withdrawal_factor=limits.withdrawal_factor,
        min_injection=daily("min_injection", rate, 0.0),
        min_withdrawal=daily("min_withdrawal", rate, 0.0),
        injection_cost=daily("injection_cost", price),
        withdrawal_cost=daily("withdrawal_cost", price),
        injection_cost_day=paid["injection_cost_settlement"],
        withdrawal_cost_day=paid["withdrawal_cost_settlement"],
        injection_fuel=daily("injection_fuel", "1", 0.0, ALMOST_ONE),
        withdrawal_fuel=daily("withdrawal_fuel", "1", 0.0, ALMOST_ONE),
        inventory_loss=daily("inventory_loss", "1/day", 0.0, ALMOST_ONE),
        inventory_cost=daily("inventory_cost", f"{price}/day"),
        at_end=_read_end(section, table, limits),
        fixed_costs=amounts,
        fixed_cost_day=amount_days,
    )


def _read_fixed_costs(section, table: ContractTable, valuation) -> tuple[Given, np.ndarray]:
    if table.fixed_costs is None:
        nothing = np.zeros(0, np.int64)
        return Given("fixed_costs", np.zeros(0), (), table.currency, nothing), nothing
    rows = read_rows(Mention(section, "fixed_costs", table.fixed_costs), ("date", "amount"))
    dates = [row.day("date") for row in rows]
    values = np.array([row.number("amount") for row in rows])
    when = ordinals(dates) - valuation.toordinal()
    # Nothing is owed any more when the contract has ended, nor what was due before today.
    due = np.flatnonzero((when >= 0) & (valuation <= table.end))
    labels = tuple(date.isoformat() for date in dates)
    return Given("fixed_costs", values, labels, table.currency, due), when[due]


def _read_end(section: Section, table: ContractTable, limits: Limits) -> EndRule:
    if table.end_inventory != "free":
        if table.end_value not in (None, 0.0):
            what = 'a value of the gas left needs end_inventory = "free"'
            raise section.error("end_value", table.end_value, what)
        return LevelAtEnd(single("end_inventory", table.end_inventory, table.volume_unit))
    if not isinstance(table.end_value, str):
        return PriceAtEnd(single("end_value", table.end_value or 0.0, "1"))
    rows = read_rows(Mention(section, "end_value", table.end_value), ("inventory", "value"))
    levels = [row.number("inventory", 0.0) for row in rows]
    for row, below, level in zip(rows[1:], levels[:-1], levels[1:], strict=True):
        if level <= below:
            raise row.error("inventory", f"inventories must rise, and the row before has {below:g}")
    low, high = (given.used()[-1] for given in (limits.min_inventory, limits.max_inventory))
    for row, inside in ((rows[0], levels[0] <= low), (rows[-1], levels[-1] >= high)):
        if not inside:
            what = f"the rows must span the inventory limits on {table.end}, {low:g} to {high:g}"
            raise row.error("inventory", what)
    values = np.array([row.number("value") for row in rows])
    labels = tuple(f"at {level:g}" for level in levels)
    index = np.arange(len(rows))
    return ValueAtEnd(
        Given("end_value_inventory", np.array(levels), labels, table.volume_unit, index),
        Given("end_value", values, labels, table.currency, index),
    )
