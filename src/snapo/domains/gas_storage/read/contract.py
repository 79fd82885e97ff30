"""Reads `[contract]`: limits, rates, forced flows, costs, the end, and the days of payment."""

import calendar
import datetime
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from snapo.case.csv import FileReference, ordinals, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.plausible import more
from snapo.case.quantity import Quantity
from snapo.case.table import TableContext

from ..contract.records import Contract, EndRule, LevelAtEnd, PriceAtEnd, ValueAtEnd
from .limits import LimitRows, small_move
from .tables import (
    GROUP,
    OF_SPOT,
    POINTS,
    STOCK,
    AfterDays,
    ContractTable,
    MonthsAfter,
    OnDate,
    Settlement,
)

LATE = 731  # days after which a payment deserves a remark


def payment_days(
    section: TableContext,
    key: str,
    rule: Settlement,
    days: Sequence[datetime.date],
    valuation: datetime.date,
    moving: np.ndarray,
    gas: np.ndarray | None = None,
) -> np.ndarray:
    """[T] integer days since `valuation` on which the flow of each of `days` is paid.

    - `moving`: [T] whether gas can move on the day; a month without such days needs no row in a
      file.
    - `gas`: [T] the days on which the gas is paid; the rule "gas" of a cost refers to them.
    """
    if rule == "gas" and gas is not None:
        return gas
    if rule == "flow":
        paid = list(days)
    elif isinstance(rule, AfterDays):
        paid = [day + datetime.timedelta(rule.days) for day in days]
    elif isinstance(rule, OnDate):
        paid = [rule.date] * len(days)
    elif isinstance(rule, MonthsAfter):
        paid = [months_after(day, rule.months, rule.day) for day in days]
    else:
        paid = _from_file(section, key, rule, days, moving, gas is not None)
    early = [day for day, when in zip(days, paid, strict=True) if when < day]
    if early:
        section.notes.append(f"{section.name}.{key}: the flow of {early[0]} is paid in advance.")
    late = [(day, when) for day, when in zip(days, paid, strict=True) if (when - day).days > LATE]
    if late:
        day, when = late[0]
        section.notes.append(
            f"{section.name}.{key}: the flow of {day} is paid on {when}, "
            f"{(when - day).days / 365:.3g} years later."
        )
    return ordinals(paid) - valuation.toordinal()


def months_after(day: datetime.date, months: int, day_of_month: int) -> datetime.date:
    """The day `day_of_month` in the month that is `months` after the month of `day`; the last day
    of a shorter month."""
    count = day.year * 12 + day.month - 1 + months
    year, month = count // 12, count % 12 + 1
    last = calendar.monthrange(year, month)[1]
    return datetime.date(year, month, min(day_of_month, last))


def _from_file(section, key, name: str, days, moving, is_cost: bool) -> list[datetime.date]:
    if not name.lower().endswith((".csv", ".parquet")):
        rules = '"flow" or "gas"' if is_cost else '"flow"'
        message = (
            f"it must be {rules}, {{ days = 10 }}, {{ date = 2021-06-20 }}, "
            "{ months = 1, day = 20 }, or a CSV file with columns delivery_month,date"
        )
        raise section.error(key, name, message)
    rows = read_rows(FileReference(section, key, name), ("delivery_month", "date"))
    paid = {}
    for row in rows:
        month = row.month("delivery_month")
        if month in paid:
            raise row.error("delivery_month", "this month already has a row")
        paid[month] = row.day("date")
    for day in (day for day, moves in zip(days, moving, strict=True) if moves):
        if (day.year, day.month) not in paid:
            message = "there is no payment date for this month, in which gas can flow; add a row"
            raise CaseError(name, f"{day:%Y-%m}", None, message)
    return [paid.get((day.year, day.month), day) for day in days]


AMOUNT = Quantity(group="cost", column="amount", meaning="amounts that are due whatever is decided")
LEVEL = replace(STOCK, column="inventory", meaning="inventories with a value of the remaining gas")
LEFT = Quantity(group=GROUP, meaning="values of the remaining gas, by inventory")
SPOT_SHARE = replace(
    POINTS,
    plausible=OF_SPOT,
    meaning="value of the remaining gas, as a share of its value at the spot price",
)


def decision_days(table: ContractTable, valuation: datetime.date) -> tuple[datetime.date, ...]:
    """The remaining decision days of the contract, from the valuation date on."""
    wait = 1 if table.first_decision == "next-day" else 0
    first = max(table.start, valuation + datetime.timedelta(wait))
    return tuple(first + datetime.timedelta(n) for n in range((table.end - first).days))


def pays_by_price(table: ContractTable) -> bool:
    """Whether the value of gas left on the end date depends on the price of that day."""
    value = table.end_value
    return table.end_inventory == "free" and isinstance(value, float | int) and value != 0


def read_contract(
    section: TableContext,
    table: ContractTable,
    days: Sequence[datetime.date],
    valuation: datetime.date,
    limits: LimitRows,
    gas_day: np.ndarray,
) -> Contract:
    """The contract on its decision days [T]; its limits also on the end date."""

    def daily(numbers: CaseInput) -> CaseInput:
        return numbers.on(days, section.notes)

    def paid(key: str) -> np.ndarray:
        rule, moving = getattr(table, key), limits.moving()
        return payment_days(section, key, rule, days, valuation, moving, gas_day)

    amounts, amount_days = _read_fixed_costs(section, table, valuation)
    return Contract(
        inventory=_stock(table.inventory, limits),
        min_inventory=limits.min_inventory,
        max_inventory=limits.max_inventory,
        ratchets=limits.ratchets,
        injection_factor=limits.injection_factor,
        withdrawal_factor=limits.withdrawal_factor,
        min_injection=daily(table.min_injection),
        min_withdrawal=daily(table.min_withdrawal),
        injection_cost=daily(table.injection_cost),
        withdrawal_cost=daily(table.withdrawal_cost),
        injection_cost_day=paid("injection_cost_settlement"),
        withdrawal_cost_day=paid("withdrawal_cost_settlement"),
        injection_fuel=daily(table.injection_fuel),
        withdrawal_fuel=daily(table.withdrawal_fuel),
        inventory_loss=daily(table.inventory_loss),
        inventory_cost=daily(table.inventory_cost),
        at_end=_read_end(section, table, limits),
        fixed_costs=amounts,
        fixed_cost_day=amount_days,
    )


def _stock(level: CaseInput, limits: LimitRows) -> CaseInput:
    """An inventory. If it is zero, a finite difference moves it by more than the minimum inventory,
    so that it stays above this."""
    return replace(level, move=2 * small_move(limits.ratchets))


def _read_fixed_costs(section, table: ContractTable, valuation) -> tuple[CaseInput, np.ndarray]:
    amount = replace(AMOUNT, unit=table.currency)
    if table.fixed_costs is None:
        nothing = np.zeros(0, np.int64)
        return amount.input("fixed_costs", np.zeros(0), ()), nothing
    rows = read_rows(FileReference(section, "fixed_costs", table.fixed_costs), ("date", "amount"))
    dates = [row.day("date") for row in rows]
    when = ordinals(dates) - valuation.toordinal()
    # Nothing is owed after the end of the contract, nor amounts due before today.
    due = np.flatnonzero((when >= 0) & (valuation <= table.end))
    before = [row for row, day in zip(rows, when) if day < 0 and valuation <= table.end]
    if before:
        section.notes.append(
            f"{table.fixed_costs}, line {before[0].line}: the amount of {before[0].day('date')} is "
            f"due before the valuation date, {valuation}{more(len(before) - 1)}: such amounts are "
            "ignored."
        )
    labels = [date.isoformat() for date in dates]
    return amount.from_rows("fixed_costs", rows, labels, index=due), when[due]


def _read_end(section: TableContext, table: ContractTable, limits: LimitRows) -> EndRule:
    if table.end_inventory != "free":
        if table.end_value not in (None, 0.0):
            message = 'the remaining gas can have a value only with end_inventory = "free"'
            raise section.error("end_value", table.end_value, message)
        stock = replace(STOCK, unit=table.volume_unit, meaning="gas owed at the end")
        position = (*section.keys, "end_inventory")
        owed = stock.input("end_inventory", [table.end_inventory], positions=(position,))
        return LevelAtEnd(_stock(owed, limits))
    if not isinstance(table.end_value, str):
        position = (*section.keys, "end_value")
        share = SPOT_SHARE.input("end_value", [table.end_value or 0.0], positions=(position,))
        return PriceAtEnd(share)
    rows = read_rows(FileReference(section, "end_value", table.end_value), ("inventory", "value"))
    levels = [row.number("inventory", 0.0) for row in rows]
    for row, below, level in zip(rows[1:], levels[:-1], levels[1:], strict=True):
        if level <= below:
            raise row.error(
                "inventory", f"inventories must increase; the previous row has {below:g}"
            )
    low, high = (limit.used()[-1] for limit in (limits.min_inventory, limits.max_inventory))
    for row, inside in ((rows[0], levels[0] <= low), (rows[-1], levels[-1] >= high)):
        if not inside:
            message = f"the rows must span the inventory limits on {table.end}, {low:g} to {high:g}"
            raise row.error("inventory", message)
    labels = [f"at {level:g}" for level in levels]
    level, left = replace(LEVEL, unit=table.volume_unit), replace(LEFT, unit=table.currency)
    return ValueAtEnd(
        level.from_rows("end_value_inventory", rows, labels),
        left.from_rows("end_value", rows, labels),
    )
