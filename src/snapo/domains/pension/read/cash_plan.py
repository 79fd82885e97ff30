"""Reads `[plan.contribution] schedule`: payments agreed in money, by date or by time from now.

A date counts as the beginning of the month that is nearest to it, like the valuation date. With
monthly steps a payment falls into its month; with yearly ones into its year, whose payments are
made together at the beginning ("advance") or at the end of it ("arrears").
"""

import datetime
import math
from typing import NamedTuple

import numpy as np

from snapo.case.csv import Mention, Row, read_rows
from snapo.case.error import CaseError, Unquoted

from ..records.plan import CashPlan
from ..records.said import amount
from .cells import NEVER, Grid, listed, years

AMOUNT = "a payment agreed in money, on top of the rule of contributions"
HALF = datetime.timedelta(15)  # of a month: a later day belongs to the next one


class Clock(NamedTuple):
    """The time of a case: its `grid`, the valuation date, and whether payments are in arrears."""

    grid: Grid
    start: datetime.date
    arrears: bool


def read_cash_plan(mention: Mention, clock: Clock) -> CashPlan:
    """The payments within the horizon; a note tells of later ones, which are left out."""
    rows = read_rows(mention, ("amount",), ("date", "year"))
    column = _column(rows)
    found, last = [], -math.inf
    for row in rows:
        label, due = _due(row, column, clock)
        if due <= last:
            raise row.error(column, "times must rise from row to row, by a month at least")
        found.append((label, _step(row, column, due, clock), row.number("amount", 0.0)))
        last = due
    inside = [each for each in found if each[1] < clock.grid.steps]
    if len(inside) < len(found):
        mention.section.notes.append(
            f"{mention.name}: {len(found) - len(inside)} of {len(found)} payments fall after the "
            "horizon and are left out."
        )
    if not inside:
        raise CaseError(mention.name, "", None, "no payment falls within the horizon")
    labels, steps, amounts = zip(*inside)
    said = amount(AMOUNT, "plan", clock.grid.currency)
    return CashPlan(
        listed("contribution_schedule", amounts, labels, said), np.array(steps, np.int64)
    )


def _column(rows: list[Row]) -> str:
    present = [each for each in ("date", "year") if each in rows[0].cells]
    if len(present) != 1:
        row = Row(rows[0].file, 1, {"header": f"the columns {', '.join(rows[0].cells)}"})
        raise row.error("header", "exactly one of the columns date and year is needed")
    return present[0]


def _due(row: Row, column: str, clock: Clock) -> tuple[str, float]:
    """The label of a payment, and its time in years from now: whole months."""
    if column == "year":
        value = row.number("year", 0.0, 100.0)
        return f"at {years(value)}", round(12 * value) / 12
    day, start = row.day("date") + HALF, clock.start + HALF
    return row.label("date"), (12 * (day.year - start.year) + day.month - start.month) / 12


def _step(row: Row, column: str, due: float, clock: Clock) -> int:
    """The step in which a payment is made."""
    steps = due / clock.grid.step
    if clock.arrears:
        steps = math.ceil(steps - NEVER) - 1
    step = math.floor(steps + NEVER)
    if step < 0:
        now = Unquoted(f"{clock.start:%Y-%m-%d}")
        what = f"payments come after the valuation date, {now}"
        raise row.error(column, f"{what}; in arrears the first one is after one step")
    return step
