"""Reads the bounds of the flows: inventory limits, rates by inventory, and outages."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from snapo.case.csv import DAY, FileReference, read_rows
from snapo.case.dates import ordinals
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ..contract.records import Ratchets
from .ratchets import read_ratchets, small_move
from .tables import ContractTable


@dataclass(frozen=True, eq=False)
class LimitRows:
    """The fields of `Contract` with the same names."""

    min_inventory: CaseInput
    max_inventory: CaseInput
    ratchets: Ratchets
    injection_factor: np.ndarray
    withdrawal_factor: np.ndarray

    def moving(self) -> np.ndarray:
        """[T] whether gas can move on the day at any inventory."""
        injection = self.ratchets.injection.used().max(axis=1) * self.injection_factor
        withdrawal = self.ratchets.withdrawal.used().max(axis=1) * self.withdrawal_factor
        return (injection > 0) | (withdrawal > 0)


def read_limits(
    section: TableContext, table: ContractTable, days: Sequence[datetime.date]
) -> LimitRows:
    """The limits on the decision days [T], those of inventory also on the end date."""
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
        message = f"on {dates[t]} it lies above max_inventory, {maximum.used()[t]:g}"
        raise section.error("min_inventory", minimum.used()[t], message)


def read_outages(
    section: TableContext, table: ContractTable, days: Sequence[datetime.date]
) -> tuple[np.ndarray, np.ndarray]:
    """[T] shares of the injection and the withdrawal rates that outages leave; the least counts."""
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
    """Remarks on outages that change nothing, and on days that have several."""
    for first, last, *_ in outages:
        if last < table.start or first >= table.end:
            section.notes.append(
                f"The outage {first} to {last} lies outside of the contract, {table.start} to "
                f"{table.end}, and changes nothing."
            )
    rising = sorted(outages)
    for before, after in pairwise(rising):
        if after[0] <= before[1]:
            section.notes.append(
                f"The outages {before[0]} to {before[1]} and {after[0]} to {after[1]} overlap; on "
                "each day the smaller factor counts."
            )


Outage = tuple[datetime.date, datetime.date, float, float]


def _outages(section: TableContext, values: list[str] | str) -> list[Outage]:
    if isinstance(values, str):
        columns = ("from", "to", "injection_factor", "withdrawal_factor")
        rows = []
        for row in read_rows(FileReference(section, "outages", values), columns):
            first, last = row.day("from"), row.day("to")
            if last < first:
                raise row.error("to", f"its last day cannot lie before its first, {first}")
            rows.append((first, last, *(row.number(column, 0.0, 1.0) for column in columns[2:])))
        return rows
    rows = []
    for text in values:
        try:
            first, last = map(_day, text.split("/"))
        except ValueError:
            message = 'an outage is written "2021-07-01/2021-07-14", first day and last day'
            raise section.error("outages", text, message) from None
        if last < first:
            raise section.error("outages", text, "the last day cannot be before the first")
        rows.append((first, last, 0.0, 0.0))
    return rows


def _day(text: str) -> datetime.date:
    if not DAY.fullmatch(text.strip()):
        raise ValueError(text)
    return datetime.date.fromisoformat(text.strip())
