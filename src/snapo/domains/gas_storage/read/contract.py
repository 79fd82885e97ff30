"""Reads `[contract]`: limits, rates, forced flows, costs and the end, each number on its days."""

import dataclasses
import datetime
from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.case.csv import Mention, read_rows
from snapo.case.dates import dated, ordinals, single
from snapo.case.given import Given
from snapo.case.plausible import more
from snapo.case.table import Section

from ..contract.end import EndRule, LevelAtEnd, PriceAtEnd, ValueAtEnd
from ..contract.records import Contract
from .limits import Limits, little
from .ratchets import GROUP
from .settlement import payment_days
from .tables import ContractTable

# Fuel and losses take less than everything.
ALMOST_ONE = float(np.nextafter(1.0, 0.0))
COST: dict[str, Any] = {"group": "cost", "move": 0.01}
# Forced flows of zero stay zero: a day has no more than one of them.
FORCED: dict[str, Any] = {"group": GROUP}
SHARE: dict[str, Any] = {
    "group": "cost",
    "move": 0.001,
    "trade_unit": "percentage point",
    "trade_factor": 100.0,
}


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
    price, flow = f"{money}/{volume}", f"{volume}/day"

    def daily(key: str, unit: str, said: dict[str, Any], words: str, low=-np.inf, high=np.inf):
        given = getattr(table, key)
        found = dated(section, key, given, unit, days, low=low, high=high, before=0.0)
        return dataclasses.replace(found, words=words, **said)

    def fuel(key: str, words: str) -> Given:
        return daily(key, "1", SHARE, words, 0.0, ALMOST_ONE)

    def paid(key: str) -> np.ndarray:
        rule, moving = getattr(table, key), limits.moving()
        return payment_days(section, key, rule, days, valuation, moving, gas_day)

    lost = SHARE | {"trade_unit": "percentage point a day", "move": 0.0001, "bump": 1e-6}
    amounts, amount_days = _read_fixed_costs(section, table, valuation)
    stock = _stock("inventory", table.inventory, volume, limits, "gas in store at the start")
    return Contract(
        inventory=stock,
        min_inventory=limits.min_inventory,
        max_inventory=limits.max_inventory,
        ratchets=limits.ratchets,
        injection_factor=limits.injection_factor,
        withdrawal_factor=limits.withdrawal_factor,
        min_injection=daily("min_injection", flow, FORCED, "injection that must flow", 0.0),
        min_withdrawal=daily("min_withdrawal", flow, FORCED, "withdrawal that must flow", 0.0),
        injection_cost=daily("injection_cost", price, COST, "per unit injected"),
        withdrawal_cost=daily("withdrawal_cost", price, COST, "per unit withdrawn"),
        injection_cost_day=paid("injection_cost_settlement"),
        withdrawal_cost_day=paid("withdrawal_cost_settlement"),
        injection_fuel=fuel("injection_fuel", "share of the injection, bought on top"),
        withdrawal_fuel=fuel("withdrawal_fuel", "share of the withdrawal, not sold"),
        inventory_loss=daily("inventory_loss", "1/day", lost, "lost gas", 0.0, ALMOST_ONE),
        inventory_cost=daily("inventory_cost", f"{price}/day", COST, "per unit in store and day"),
        at_end=_read_end(section, table, limits),
        fixed_costs=amounts,
        fixed_cost_day=amount_days,
    )


def _stock(key: str, level: float, unit: str, limits: Limits, words: str) -> Given:
    """An inventory; one of zero moves by more than the least inventory does, and stays above it."""
    move = 2 * little(limits.ratchets)
    return dataclasses.replace(single(key, level, unit), words=words, group=GROUP, move=move)


def _read_fixed_costs(section, table: ContractTable, valuation) -> tuple[Given, np.ndarray]:
    if table.fixed_costs is None:
        nothing = np.zeros(0, np.int64)
        return Given("fixed_costs", np.zeros(0), (), table.currency, nothing), nothing
    rows = read_rows(Mention(section, "fixed_costs", table.fixed_costs), ("date", "amount"))
    dates = [row.day("date") for row in rows]
    values = np.array([row.number("amount") for row in rows])
    when = ordinals(dates) - valuation.toordinal()
    # Nothing is owed any more when the contract has ended, nor amounts due before today.
    due = np.flatnonzero((when >= 0) & (valuation <= table.end))
    before = [row for row, day in zip(rows, when) if day < 0 and valuation <= table.end]
    if before:
        section.notes.append(
            f"{table.fixed_costs}, line {before[0].line}: the amount of {before[0].day('date')} is "
            f"due before the valuation date, {valuation}{more(len(before) - 1)}: it does not count."
        )
    labels = tuple(date.isoformat() for date in dates)
    said: dict[str, Any] = {"group": "cost", "words": "amounts owed in any case"}
    return Given("fixed_costs", values, labels, table.currency, due, **said), when[due]


def _read_end(section: Section, table: ContractTable, limits: Limits) -> EndRule:
    if table.end_inventory != "free":
        if table.end_value not in (None, 0.0):
            what = 'a value of the gas left needs end_inventory = "free"'
            raise section.error("end_value", table.end_value, what)
        level, unit = table.end_inventory, table.volume_unit
        return LevelAtEnd(_stock("end_inventory", level, unit, limits, "gas owed at the end"))
    if not isinstance(table.end_value, str):
        share = single("end_value", table.end_value or 0.0, "1")
        words = "of the gas left, as a share of its spot value"
        return PriceAtEnd(dataclasses.replace(share, words=words, **SHARE))
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
    index, unit = np.arange(len(rows)), table.volume_unit
    said: dict[str, Any] = {"group": "contract", "words": "rows of the value of the gas left"}
    return ValueAtEnd(
        Given("end_value_inventory", np.array(levels), labels, unit, index, **said),
        Given("end_value", values, labels, table.currency, index, **said),
    )
