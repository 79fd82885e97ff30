"""When gas and costs are paid: a rule of the case becomes one payment day per decision day."""

import calendar
import datetime
from collections.abc import Sequence

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.dates import ordinals
from snapo.case.error import CaseError
from snapo.case.table import TableContext

from .tables import AfterDays, MonthsAfter, OnDate, Settlement

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

    - `moving`: [T] whether gas can move on the day; a month in which none can needs no row.
    - `gas`: [T] the same for the gas itself, which the rule "gas" of a cost refers to.
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
        section.notes.append(f"By {section.name}.{key} the flow of {early[0]} is paid before it.")
    late = [(day, when) for day, when in zip(days, paid, strict=True) if (when - day).days > LATE]
    if late:
        day, when = late[0]
        section.notes.append(
            f"By {section.name}.{key} the flow of {day} is paid on {when}, "
            f"{(when - day).days / 365:.3g} years later."
        )
    return ordinals(paid) - valuation.toordinal()


def months_after(day: datetime.date, months: int, day_of_month: int) -> datetime.date:
    """That day of the month `months` after the month of `day`; the last one of a short month."""
    count = day.year * 12 + day.month - 1 + months
    year, month = count // 12, count % 12 + 1
    last = calendar.monthrange(year, month)[1]
    return datetime.date(year, month, min(day_of_month, last))


def _from_file(section, key, name: str, days, moving, is_cost: bool) -> list[datetime.date]:
    if not name.lower().endswith((".csv", ".parquet")):
        rules = '"flow" or "gas"' if is_cost else '"flow"'
        message = (
            f"allowed is {rules}, {{ days = 10 }}, {{ date = 2021-06-20 }}, "
            "{ months = 1, day = 20 }, or a CSV file with columns delivery_month,date"
        )
        raise section.error(key, name, message)
    rows = read_rows(FileReference(section, key, name), ("delivery_month", "date"))
    paid = {}
    for row in rows:
        month = row.month("delivery_month")
        if month in paid:
            raise row.error("delivery_month", "this month has a row already")
        paid[month] = row.day("date")
    for day in (day for day, moves in zip(days, moving, strict=True) if moves):
        if (day.year, day.month) not in paid:
            message = "there is no payment date for this month, in which gas can move; add a row"
            raise CaseError(name, f"{day:%Y-%m}", None, message)
    return [paid.get((day.year, day.month), day) for day in days]
