"""Reads the bounds of the flows: inventory limits, rates by inventory (ratchets), and outages."""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from snapo.case.csv import DAY, FileReference, Row, ordinals, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import NOT_NEGATIVE, Quantity
from snapo.case.table import TableContext

from ..contract.records import Ratchets
from .tables import FLOW, GROUP, ContractTable

COLUMNS = ("date", "inventory", "max_withdrawal", "max_injection")
LEVEL = Quantity(
    "{volume_unit}", NOT_NEGATIVE, GROUP, move=1.0, column="inventory",
    meaning="inventories of the ratchet rows",
)  # fmt: skip
INJECTION = replace(
    LEVEL, unit=FLOW, column="max_injection", meaning="largest injection per day, by inventory"
)
WITHDRAWAL = replace(
    LEVEL, unit=FLOW, column="max_withdrawal", meaning="largest withdrawal per day, by inventory"
)


def read_ratchets(
    section: TableContext,
    table: ContractTable,
    days: Sequence[datetime.date],
    minimum: np.ndarray,
    maximum: np.ndarray,
) -> Ratchets:
    """The rates on `days` [T]; `minimum`, `maximum`: the inventory limits that the rows must
    span."""
    plain = [key for key in ("max_injection", "max_withdrawal") if getattr(table, key) is not None]
    if table.ratchets is None:
        return _plain_rates(section, table, plain, days)
    if plain:
        message = f"specify either {plain[0]} or ratchets, not both"
        raise section.error(plain[0], getattr(table, plain[0]).written, message)
    rows = read_rows(FileReference(section, "ratchets", table.ratchets), COLUMNS)
    blocks = read_blocks(rows)
    index = _rows_by_day(table.ratchets, blocks, days)
    ratchets = _ratchets(rows, blocks, index, table)
    _check_span(table, ratchets, days, minimum, maximum)
    return ratchets


def _plain_rates(section, table: ContractTable, plain, days) -> Ratchets:
    for key in ("max_injection", "max_withdrawal"):
        if key not in plain:
            raise section.error(
                key,
                None,
                "this key is missing; specify max_injection and max_withdrawal, or ratchets",
            )

    def rate(numbers: CaseInput) -> CaseInput:
        numbers = numbers.on(days, section.notes)
        return replace(numbers, index=numbers.index[:, None])

    assert table.max_injection is not None and table.max_withdrawal is not None
    everywhere = np.zeros((len(days), 1), np.int64)
    level = replace(LEVEL, unit=table.volume_unit)
    # No file has this inventory: plain rates hold at every one.
    inventory = level.input("ratchet_inventory", [0.0], index=everywhere, positions=(None,))
    return Ratchets(inventory, rate(table.max_withdrawal), rate(table.max_injection), "step")


def small_move(ratchets: Ratchets) -> float:
    """The move of a limit that is zero in a finite difference: a power of ten, at most a thousandth
    of the largest daily rate."""
    rates = (ratchets.injection.used(), ratchets.withdrawal.used())
    largest = max(float(np.max(rate, initial=0.0)) for rate in rates)
    return 10.0 ** math.floor(math.log10(1e-3 * largest)) if largest > 0 else 1e-3


RatchetBlock = tuple[datetime.date, list[int]]


def read_blocks(rows: Sequence[Row]) -> list[RatchetBlock]:
    """Groups rows by date into blocks, each with its date and its row numbers, in which inventories
    rise.

    A row continues the block if its date is empty or repeated.
    """
    blocks: list[RatchetBlock] = []
    for number, row in enumerate(rows):
        date = row.day("date") if row.cells["date"] else None
        if date is None and not blocks:
            raise row.error(
                "date", "the first row needs the date from which its block of rows applies"
            )
        if date is None or (blocks and date == blocks[-1][0]):
            _check_rises(rows[blocks[-1][1][-1]], row)
            blocks[-1][1].append(number)
        elif blocks and date < blocks[-1][0]:
            message = (
                f"blocks must be in order of date, but the previous block begins on {blocks[-1][0]}"
            )
            raise row.error("date", message)
        else:
            blocks.append((date, [number]))
    return blocks


def _check_rises(before: Row, row: Row) -> None:
    level = before.number("inventory", 0.0)
    if row.number("inventory", 0.0) <= level:
        message = f"within a block inventories must increase; the previous row has {level:g}"
        raise row.error("inventory", message)


def _rows_by_day(name: str, blocks: Sequence[RatchetBlock], days) -> np.ndarray:
    """[T, K] the row numbers of the block of each day; shorter blocks repeat their last row."""
    maximum = max(len(numbers) for _, numbers in blocks)
    padded = np.array([numbers + numbers[-1:] * (maximum - len(numbers)) for _, numbers in blocks])
    starts = ordinals([date for date, _ in blocks])
    if days and blocks[0][0] > days[0]:
        message = (
            f"ratchets are needed from {days[0]} on, but the first block begins on this later date"
        )
        raise CaseError(name, "date", blocks[0][0], message)
    return padded[np.searchsorted(starts, ordinals(days), side="right") - 1]


def _ratchets(rows, blocks, index: np.ndarray, table: ContractTable) -> Ratchets:
    dates = {number: date for date, numbers in blocks for number in numbers}
    levels = [row.number("inventory", 0.0) for row in rows]
    labels = [f"{dates[number]} at {level:g}" for number, level in enumerate(levels)]
    units = {"currency": table.currency, "volume_unit": table.volume_unit}

    def column(name: str, quantity: Quantity) -> CaseInput:
        quantity = replace(quantity, unit=quantity.unit.format_map(units))
        return quantity.from_rows(name, rows, labels, index=index)

    return Ratchets(
        column("ratchet_inventory", LEVEL),
        column("ratchet_withdrawal", WITHDRAWAL),
        column("ratchet_injection", INJECTION),
        table.ratchet_interpolation,
    )


def _check_span(table: ContractTable, ratchets: Ratchets, days, minimum, maximum) -> None:
    """Refuses ratchets without rates for an inventory within the limits of a day: rates are not
    extrapolated."""
    levels = ratchets.inventory.used()
    low, high = levels[:, 0], levels[:, -1]
    linear = ratchets.interpolation == "linear"
    short = (low > minimum[:-1]) | (linear & (high < maximum[:-1]))
    for t in np.flatnonzero(short)[:1]:
        block = ratchets.inventory.labels[ratchets.inventory.index[t, 0]].split(" ")[0]
        below = low[t] > minimum[t]
        key, limit = ("min_inventory", minimum[t]) if below else ("max_inventory", maximum[t])
        level = low[t] if below else high[t]
        message = (
            f"the {'first' if below else 'last'} row of this block must reach {key}, "
            f"{limit:g} on {days[t]}"
        )
        raise CaseError(str(table.ratchets), f"block of {block}", float(level), message)


@dataclass(frozen=True, eq=False)
class LimitRows:
    """The limits of flows and inventories: the fields of `Contract` with the same names."""

    min_inventory: CaseInput
    max_inventory: CaseInput
    ratchets: Ratchets
    injection_factor: np.ndarray
    withdrawal_factor: np.ndarray

    def moving(self) -> np.ndarray:
        """[T] whether gas can flow on the day at any inventory."""
        injection = self.ratchets.injection.used().max(axis=1) * self.injection_factor
        withdrawal = self.ratchets.withdrawal.used().max(axis=1) * self.withdrawal_factor
        return (injection > 0) | (withdrawal > 0)


def read_limits(
    section: TableContext, table: ContractTable, days: Sequence[datetime.date]
) -> LimitRows:
    """The limits on the decision days [T]; the inventory limits also on the end date."""
    dates = (*days, table.end)
    minimum = table.min_inventory.on(dates, section.notes)
    maximum = table.max_inventory.on(dates, section.notes)
    _check_limits(section, dates, minimum, maximum)
    ratchets = read_ratchets(section, table, days, minimum.used(), maximum.used())
    return LimitRows(
        replace(minimum, move=small_move(ratchets)),
        maximum,
        ratchets,
        *read_outages(section, table, days),
    )


def _check_limits(section: TableContext, dates, minimum: CaseInput, maximum: CaseInput) -> None:
    crossed = np.flatnonzero(minimum.used() > maximum.used())
    if len(crossed):
        t = crossed[0]
        message = f"on {dates[t]} it is above max_inventory, {maximum.used()[t]:g}"
        raise section.error("min_inventory", minimum.used()[t], message)


def read_outages(
    section: TableContext, table: ContractTable, days: Sequence[datetime.date]
) -> tuple[np.ndarray, np.ndarray]:
    """[T] the shares of the injection and of the withdrawal rates that outages leave; on a day with
    several outages the smallest share applies."""
    factors = np.ones((2, len(days)))
    day_numbers = ordinals(days)
    outages = _outages(section, table.outages)
    _note_outages(section, table, outages)
    for first, last, *left in outages:
        during = (day_numbers >= first.toordinal()) & (day_numbers <= last.toordinal())
        for factor, share in zip(factors, left, strict=True):
            factor[during] = np.minimum(factor[during], share)
    return factors[0], factors[1]


def _note_outages(section: TableContext, table: ContractTable, outages: "list[Outage]") -> None:
    """Notes on outages that change nothing, and on days with several outages."""
    for first, last, *_ in outages:
        if last < table.start or first >= table.end:
            section.notes.append(
                f"The outage {first} to {last} is outside of the contract, {table.start} to "
                f"{table.end}, and changes nothing."
            )
    rising = sorted(outages)
    for before, after in pairwise(rising):
        if after[0] <= before[1]:
            section.notes.append(
                f"The outages {before[0]} to {before[1]} and {after[0]} to {after[1]} overlap; on "
                "each day the smaller factor applies."
            )


Outage = tuple[datetime.date, datetime.date, float, float]


def _outages(section: TableContext, values: list[str] | str) -> list[Outage]:
    if isinstance(values, str):
        columns = ("from", "to", "injection_factor", "withdrawal_factor")
        rows = []
        for row in read_rows(FileReference(section, "outages", values), columns):
            first, last = row.day("from"), row.day("to")
            if last < first:
                raise row.error("to", f"the last day must not be before the first day, {first}")
            rows.append((first, last, *(row.number(column, 0.0, 1.0) for column in columns[2:])))
        return rows
    rows = []
    for text in values:
        try:
            first, last = map(_day, text.split("/"))
        except ValueError:
            message = (
                'an outage must be written like "2021-07-01/2021-07-14": first day and last day'
            )
            raise section.error("outages", text, message) from None
        if last < first:
            raise section.error("outages", text, "the last day must not be before the first day")
        rows.append((first, last, 0.0, 0.0))
    return rows


def _day(text: str) -> datetime.date:
    if not DAY.fullmatch(text.strip()):
        raise ValueError(text)
    return datetime.date.fromisoformat(text.strip())
