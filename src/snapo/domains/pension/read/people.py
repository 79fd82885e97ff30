"""Reads `[members]`: the cohorts of the fund, or the actuary's cash flows."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import mul

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.given import CaseInput, ConvertedNumber
from snapo.case.quantity import ANY
from snapo.case.table import TableContext

from ..quantities import AMOUNT
from ..records.people import ACTIVE, PAYMENT_YEARS, CashFlows, FundMembers, Mortality
from .cells import WHOLE, TableReader, TimeGrid, empty, number, unique, word, years
from .mortality import SEX
from .tables_people import MembersTable

STATUS = ("active", "deferred", "pensioner", "spouse")
PEOPLE = AMOUNT.of("people")
NUMBER = PEOPLE.in_column("number", "the number of members of a cohort", unit="members")
PENSION = PEOPLE.in_column("pension", "the yearly pension that each member has earned")
SALARY = PEOPLE.in_column(
    "salary", "the salary of each member; contributions and accrual change with it"
)
FACTOR = PEOPLE.of("people", unit="1", blank=1.0).in_column(
    "mortality", "the death probabilities of a cohort rise by a relative 1 %"
)
FLOW = PEOPLE.in_column("amount", "an expected payment", range=ANY)


def read_members(
    section: TableContext,
    table: MembersTable,
    mortality: Mortality,
    retirement_age: float,
    grid: TimeGrid,
) -> FundMembers:
    """The cohorts, whose ages must be within the mortality table."""
    columns = ("name", "status", "sex", "age", "number", "pension")
    more = ("salary", "service", "mortality")
    rows = read_rows(FileReference(section, "file", str(table.file)), columns, more)
    names = unique(rows, "name")
    status = np.array([STATUS.index(word(row, "status", STATUS)) for row in rows], np.int64)
    sex = np.array([SEX.index(word(row, "sex", SEX)) for row in rows], np.int64)
    last = mortality.first_age + mortality.ages
    age = np.array([_age(row, mortality.first_age, last) for row in rows])
    for row, item, old in zip(rows, status, age):
        if item == ACTIVE and old >= retirement_age:
            raise row.error("age", f"an active member must be younger than {retirement_age:g}")
        row.cells.setdefault("salary", "")
        if item != ACTIVE and number(row, "salary", 0.0) != 0:
            raise row.error("salary", "only active members can have a salary")
    yearly = f"{grid.currency}/year"
    return FundMembers(
        names=names,
        status=status,
        sex=sex,
        age=age,
        number=NUMBER.from_rows("members", rows, names),
        pension=replace(PENSION, unit=yearly).from_rows("accrued_pension", rows, names),
        salary=_salary(rows, status, names, yearly),
        service=np.array([number(row, "service", 0.0, 0.0) for row in rows]),
        mortality=_factor(rows, names),
    )


def _factor(rows: Sequence[Row], names: Sequence[str]) -> CaseInput | None:
    """Factors on death probabilities, 1 in an empty cell; None without the column."""
    if not any(row.cells.get("mortality") for row in rows):
        return None
    return FACTOR.from_rows("member_mortality", rows, names)


def _age(row: Row, first: int, last: int) -> float:
    age = row.number("age", 0.0)
    if not first <= age < last:
        message = f"the mortality table has the ages {first} to {last - 1}"
        raise row.error("age", message)
    return age


def _salary(rows: Sequence[Row], status: np.ndarray, names, unit: str) -> CaseInput:
    """The salaries of active members; others have no salary that could be an input."""
    active = [i for i, item in enumerate(status) if item == ACTIVE]
    if not active:
        return empty("salary", (len(rows),))
    index = np.zeros(len(rows), np.int64)
    index[active] = np.arange(len(active))
    salary, paid = replace(SALARY, unit=unit), [rows[i] for i in active]
    return salary.from_rows("salary", paid, [names[i] for i in active], index=index)


def read_cash_flows(
    section: TableReader, table: MembersTable, arrears: bool, grid: TimeGrid
) -> CashFlows:
    """The actuary's expected payments; their times in years from now are whole steps."""
    name = str(table.cash_flows)
    rows = read_rows(FileReference(section, "cash_flows", name), ("year", "amount"))
    steps = []
    for row in rows:
        due = row.number("year", 0.0, PAYMENT_YEARS) / grid.step
        if abs(due - round(due)) > WHOLE:
            raise row.error("year", f"it must be a whole number of steps of {years(grid.step)}")
        paid = round(due) - arrears
        if paid < 0:
            raise row.error("year", "with payments in arrears the first payment is after one step")
        if paid >= round(PAYMENT_YEARS / grid.step):
            raise row.error("year", f"payments in advance must be before year {PAYMENT_YEARS}")
        if steps and paid <= steps[-1]:
            raise row.error("year", "times must increase from row to row")
        steps.append(paid)
    labels = [f"at {years(row.number('year'))}" for row in rows]
    money = grid.currency
    cost = table.normal_cost
    in_step, in_year = partial(mul, grid.step), partial(mul, 1 / grid.step)
    normal_cost = replace(
        cost,
        unit=f"{money}/step",
        values=cost.values * grid.step,
        positions=tuple(ConvertedNumber(x, in_step, in_year) for x in cost.positions),
    )
    payroll = replace(table.salary, unit=f"{money}/year")
    return CashFlows(
        amount=replace(FLOW, unit=money).from_rows("cash_flow", rows, labels),
        step=np.array(steps, np.int64),
        normal_cost=section.input(table, "normal_cost", normal_cost),
        salary=section.input(table, "salary", payroll),
    )
