"""Reads `[members]`: the cohorts of the fund, or the actuary's cash flows."""

from collections.abc import Sequence

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ..records.people import ACTIVE, PAYMENT_YEARS, CashFlows, FundMembers, Mortality
from ..records.said import amount
from .cells import (
    WHOLE,
    TableReader,
    TimeGrid,
    empty,
    listed,
    number,
    single,
    unique,
    word,
    years,
)
from .mortality import SEX
from .tables_people import MembersTable

STATUS = ("active", "deferred", "pensioner", "spouse")
NUMBER = amount("the number of members of a cohort", "people", "members")
PENSION = "the yearly pension that each member has earned"
SALARY = "the salary of each member, and with it contributions and accrual"
FACTOR = amount("the death probabilities of a cohort rise by 1 % of themselves", "people", "1")
FLOW, COST = "an expected payment", "the value of the accrual of a step today"


def read_members(
    section: TableContext,
    table: MembersTable,
    mortality: Mortality,
    retirement_age: float,
    grid: TimeGrid,
) -> FundMembers:
    """Cohorts, each within the ages of the mortality table."""
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
            raise row.error("age", f"an active member is younger than {retirement_age:g}")
        row.cells.setdefault("salary", "")
        if item != ACTIVE and number(row, "salary", 0.0) != 0:
            raise row.error("salary", "only active members have a salary")
    money = grid.currency
    return FundMembers(
        names=names,
        status=status,
        sex=sex,
        age=age,
        number=listed("members", _each(rows, "number"), names, NUMBER),
        pension=listed(
            "accrued_pension",
            _each(rows, "pension"),
            names,
            amount(PENSION, "people", f"{money}/year"),
        ),
        salary=_salary(rows, status, names, money),
        service=np.array([number(row, "service", 0.0, 0.0) for row in rows]),
        mortality=_factor(rows, names),
    )


def _factor(rows: Sequence[Row], names: Sequence[str]) -> CaseInput | None:
    """Factors on death probabilities, 1 in an empty cell; None without the column."""
    if not any(row.cells.get("mortality") for row in rows):
        return None
    return listed("member_mortality", [number(row, "mortality", 1.0, 0.0) for row in rows], names,
                  FACTOR)  # fmt: skip


def _age(row: Row, first: int, last: int) -> float:
    age = row.number("age", 0.0)
    if not first <= age < last:
        message = f"the mortality table has the ages {first} to {last - 1}"
        raise row.error("age", message)
    return age


def _each(rows: Sequence[Row], column: str) -> list[float]:
    return [row.number(column, 0.0) for row in rows]


def _salary(rows: Sequence[Row], status: np.ndarray, names, money: str) -> CaseInput:
    """Salaries of those who are active; who is not has no salary that could be an input."""
    active = [i for i, item in enumerate(status) if item == ACTIVE]
    if not active:
        return empty("salary", (len(rows),))
    values = [rows[i].number("salary", 0.0) for i in active]
    index = np.zeros(len(rows), np.int64)
    index[active] = np.arange(len(active))
    metadata = amount(SALARY, "people", f"{money}/year")
    return metadata.input("salary", values, [names[i] for i in active], index)


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
            raise row.error("year", f"allowed is a whole number of steps of {years(grid.step)}")
        paid = round(due) - arrears
        if paid < 0:
            raise row.error("year", "with payments in arrears the first one is after one step")
        if paid >= round(PAYMENT_YEARS / grid.step):
            raise row.error("year", f"payments in advance end before {PAYMENT_YEARS} years")
        if steps and paid <= steps[-1]:
            raise row.error("year", "times must rise from row to row")
        steps.append(paid)
    labels = [f"at {years(row.number('year'))}" for row in rows]
    money = grid.currency
    flow = amount(FLOW, "people", money)
    cost = amount(COST, "people", f"{money}/step")
    pay = amount("all salaries", "people", f"{money}/year")
    normal_cost = single("normal_cost", table.normal_cost * grid.step, cost)
    return CashFlows(
        amount=listed("cash_flow", [row.number("amount") for row in rows], labels, flow),
        step=np.array(steps, np.int64),
        normal_cost=section.input(table, "normal_cost", normal_cost),
        salary=section.input(table, "salary", single("payroll", table.salary, pay)),
    )
