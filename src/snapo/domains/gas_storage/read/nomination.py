"""Nominations: a flow is fixed some days before its date, at a forward price."""

import datetime
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np

from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, doc

from .tables import DateKey


class NominationTable(CaseTable):
    """{ days = 1, calendar = "business" }: a flow is fixed this number of days before its date.

    With one business day, the flows of a weekend and of Monday are fixed on Friday; `holidays` are
    not business days.
    """

    days: Annotated[int, Range(1, 60)] = doc("days from the nomination of a flow to its date", 1)
    calendar: Literal["every-day", "business"] = doc(
        "the kind of days that are counted", "every-day"
    )
    holidays: list[DateKey] = doc("days without business", [], "a list of dates like [2026-12-25]")


def nominated_on(
    where: TableContext, table: Any, dates: Sequence[datetime.date]
) -> tuple[datetime.date, ...] | None:
    """[n] the day on which the flow of each date is fixed; None if `table`, the table `[contract]`,
    has no `nomination`."""
    if table.nomination is None:
        return None
    nomination = where.nested(NominationTable, table.nomination, "nomination")
    where.notes.append(
        "contract.nomination: flows are fixed days in advance. The paths have the prices and cash "
        "flows at the nominations, which vary less than those on the days of the flows."
    )
    if nomination.calendar == "every-day":
        return tuple(date - datetime.timedelta(nomination.days) for date in dates)
    fixed = np.busday_offset(
        np.array(dates, "datetime64[D]"), -nomination.days, "forward", holidays=nomination.holidays
    )
    return tuple(fixed.tolist())


def check_nomination(where: TableContext, table: Any, objective: str, products: Any) -> None:
    """Raises `CaseError` if a key of the case needs the spot price of the date of a flow."""
    if table.nomination is None:
        return
    if objective != "mean":
        message = (
            "a flow is counted at the forward price of its nomination, so that "
            f'"{objective}" cannot be computed; the objective must be "mean"'
        )
        raise where.error("nomination", None, message)
    if products is not None:
        message = (
            "it cannot be used with [products], which are traded on the days of the flows; leave "
            "out either nomination or [products]"
        )
        raise where.error("nomination", None, message)
