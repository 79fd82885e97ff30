"""Reads `[plan.contribution] schedule`: payments agreed in money, by date or by time from now.

A date counts as the beginning of the month that is nearest to it, like the valuation date. With
monthly steps a payment falls into its month. With yearly steps it falls into its year, and all
payments of a year are made together at its beginning ("advance") or its end ("arrears").
"""

import datetime
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError, Unquoted

from ..quantities import AMOUNT
from ..records.plan import CashPlan
from .cells import NEVER, TimeGrid, years

PAYMENT = AMOUNT.of("plan").in_column(
    "amount", "a payment agreed in money, in addition to the rule of contributions"
)
HALF = datetime.timedelta(15)  # of a month: a later day belongs to the next one


class PlanClock(NamedTuple):
    """The time of a case: its `grid`, the valuation date, and whether payments are in arrears."""

    grid: TimeGrid
    start: datetime.date
    arrears: bool


def read_cash_plan(reference: FileReference, timer: PlanClock) -> CashPlan:
    """The payments within the horizon; a note reports later ones, which are omitted."""
    rows = read_rows(reference, ("amount",), ("date", "year"))
    column = _column(rows)
    results, last = [], -math.inf
    for row in rows:
        label, due = _due(row, column, timer)
        if due <= last:
            raise row.error(column, "times must increase from row to row, by at least a month")
        results.append((label, _step(row, column, due, timer), row))
        last = due
    inside = [item for item in results if item[1] < timer.grid.steps]
    if len(inside) < len(results):
        reference.section.notes.append(
            f"{reference.name}: {len(results) - len(inside)} of {len(results)} payments fall "
            "after the horizon and are left out."
        )
    if not inside:
        raise CaseError(reference.name, "", None, "no payment falls within the horizon")
    labels, steps, paid = zip(*inside)
    payment = replace(PAYMENT, unit=timer.grid.currency)
    amounts = payment.from_rows("contribution_schedule", paid, labels)
    return CashPlan(amounts, np.array(steps, np.int64))


def _column(rows: list[Row]) -> str:
    present = [name for name in ("date", "year") if name in rows[0].cells]
    if len(present) != 1:
        row = Row(rows[0].file, 1, {"header": f"the columns {', '.join(rows[0].cells)}"})
        raise row.error("header", "exactly one of the columns date and year is needed")
    return present[0]


def _due(row: Row, column: str, timer: PlanClock) -> tuple[str, float]:
    """The label of a payment, and its time in years from now: whole months."""
    if column == "year":
        value = row.number("year", 0.0, 100.0)
        return f"at {years(value)}", round(12 * value) / 12
    day, start = row.day("date") + HALF, timer.start + HALF
    return row.label("date"), (12 * (day.year - start.year) + day.month - start.month) / 12


def _step(row: Row, column: str, due: float, timer: PlanClock) -> int:
    """The step in which a payment is made."""
    steps = due / timer.grid.step
    if timer.arrears:
        steps = math.ceil(steps - NEVER) - 1
    step = math.floor(steps + NEVER)
    if step < 0:
        now = Unquoted(f"{timer.start:%Y-%m-%d}")
        message = f"payments must be on or after the valuation date, {now}"
        raise row.error(column, f"{message}; in arrears the first payment is after one step")
    return step
