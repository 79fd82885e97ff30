"""Reads `[members]`, `[mortality]` and `[lee_carter]`: who is in the fund, and how they die."""

from collections.abc import Sequence

import numpy as np

from snapo.case.csv import Mention, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import Given
from snapo.case.table import Section

from .case_assets import WHOLE, Grid
from .case_curve import SQUARE_ROOT, YEARLY
from .cells import empty, listed, number, single, unique, word, years
from .records_people import (
    ACTIVE,
    FEMALE,
    MALE,
    PAYMENT_YEARS,
    CashFlows,
    LeeCarter,
    Members,
    Mortality,
)
from .tables import LeeCarterTable, MembersTable, MortalityTable

STATUS = ("active", "deferred", "pensioner", "spouse")
SEX = ("male", "female")
FORMULA_AGES = (16, 105)  # first age and number of ages of a formula: 16 to 120


def read_members(
    section: Section, table: MembersTable, mortality: Mortality, retirement_age: float, grid: Grid
) -> Members:
    """Cohorts, each within the ages of the mortality table."""
    columns = ("name", "status", "sex", "age", "number", "pension")
    rows = read_rows(Mention(section, "file", str(table.file)), columns)
    names = unique(rows, "name")
    status = np.array([STATUS.index(word(row, "status", STATUS)) for row in rows], np.int64)
    sex = np.array([SEX.index(word(row, "sex", SEX)) for row in rows], np.int64)
    last = mortality.first_age + mortality.ages
    age = np.array([_age(row, mortality.first_age, last) for row in rows])
    for row, each, old in zip(rows, status, age):
        if each == ACTIVE and old >= retirement_age:
            raise row.error("age", f"an active member is younger than {retirement_age:g}")
        row.cells.setdefault("salary", "")
        if each != ACTIVE and number(row, "salary", 0.0) != 0:
            raise row.error("salary", "only active members have a salary")
    money = grid.currency
    return Members(
        names=names,
        status=status,
        sex=sex,
        age=age,
        number=listed("members", [row.number("number", 0.0) for row in rows], names, "members"),
        pension=listed("accrued_pension", _each(rows, "pension"), names, f"{money}/year"),
        salary=_salary(rows, status, names, money),
        service=np.array([number(row, "service", 0.0, 0.0) for row in rows]),
    )


def _age(row: Row, first: int, last: int) -> float:
    age = row.number("age", 0.0)
    if not first <= age < last:
        what = f"the mortality table has the ages {first} to {last - 1}"
        raise row.error("age", what)
    return age


def _each(rows: Sequence[Row], column: str) -> list[float]:
    return [row.number(column, 0.0) for row in rows]


def _salary(rows: Sequence[Row], status: np.ndarray, names, money: str) -> Given:
    """Salaries of those who are active; who is not has no salary that could be an input."""
    active = [i for i, each in enumerate(status) if each == ACTIVE]
    if not active:
        return empty("salary", (len(rows),), f"{money}/year")
    values = [rows[i].number("salary", 0.0) for i in active]
    index = np.zeros(len(rows), np.int64)
    index[active] = np.arange(len(active))
    labels = tuple(names[i] for i in active)
    return Given("salary", np.array(values), labels, f"{money}/year", index)


def read_cash_flows(section: Section, table: MembersTable, arrears: bool, grid: Grid) -> CashFlows:
    """The actuary's expected payments; their times in years from now are whole steps."""
    name = str(table.cash_flows)
    rows = read_rows(Mention(section, "cash_flows", name), ("year", "amount"))
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
    return CashFlows(
        amount=listed("cash_flow", [row.number("amount") for row in rows], labels, money),
        step=np.array(steps, np.int64),
        normal_cost=single("normal_cost", table.normal_cost * grid.step, f"{money}/step"),
        salary=single("payroll", table.salary, f"{money}/year"),
    )


def read_mortality(section: Section, table: MortalityTable) -> Mortality:
    """Death probabilities by sex and age, or Gompertz-Makeham, with what modifies them."""
    if table.kind == "table":
        for key in ("male", "female"):
            if getattr(table, key) is not None:
                raise section.error(key, getattr(table, key), 'kind "table" has no such key')
        if table.file is None:
            raise section.error("file", None, 'kind "table" needs this key')
        first, probability = _table(section, table.file)
        count = len(probability.values) // 2
        formula = empty("gompertz", (2, 3))
    else:
        if table.file is not None:
            raise section.error("file", table.file, f'kind "{table.kind}" has no such key')
        (first, count), formula = FORMULA_AGES, _gompertz(section, table)
        probability = empty("death_probability", (2, count))
    ages = range(first, first + count)
    return Mortality(
        kind=table.kind,
        first_age=first,
        ages=count,
        table=probability,
        gompertz=formula,
        multiplier=_banded(section, "multiplier", "mortality_multiplier", table.multiplier, ages),
        improvement=_banded(section, "improvement", "improvement", table.improvement, ages, -1.0),
    )


def _table(section: Section, file: str) -> tuple[int, Given]:
    """First age and q [2, G]: both sexes, every age from the first to the last."""
    rows = read_rows(Mention(section, "file", file), ("sex", "age", "q"))
    found: dict[tuple[int, int], float] = {}
    for row in rows:
        key = SEX.index(word(row, "sex", SEX)), _whole_age(row)
        if key in found:
            raise row.error("age", "this age stands further up already")
        found[key] = row.number("q", 0.0, 1.0)
    ages = sorted({age for _, age in found})
    for sex in (MALE, FEMALE):
        for age in range(ages[0], ages[-1] + 1):
            if (sex, age) not in found:
                got = Unquoted(f"no row for {SEX[sex]}, {age}")
                what = f"both sexes need every age from {ages[0]} to {ages[-1]}"
                raise section.error("file", got, f"{what} in {file}")
    order = [(sex, age) for sex in (MALE, FEMALE) for age in range(ages[0], ages[-1] + 1)]
    labels = tuple(f"{SEX[sex]} {age}" for sex, age in order)
    values = np.array([found[key] for key in order])
    return ages[0], Given("death_probability", values, labels, "1", _square(len(order)))


def _square(count: int) -> np.ndarray:
    return np.arange(count).reshape(2, -1)


def _whole_age(row: Row) -> int:
    age = row.number("age", 0.0, 150.0)
    if age != int(age):
        raise row.error("age", "allowed is a whole number of years")
    return int(age)


def _gompertz(section: Section, table: MortalityTable) -> Given:
    """alpha, beta and makeham by sex [2, 3]."""
    values: list[float] = []
    for key in SEX:
        given = getattr(table, key)
        if given is None:
            raise section.error(key, None, f'kind "{table.kind}" needs this key')
        alpha, beta, makeham = (*given, 0.0)[:3]
        if beta <= 0 or makeham < 0:
            raise section.error(key, given, "beta is above 0 and makeham at least 0")
        values += [alpha, beta, makeham]
    labels = [f"{sex} {part}" for sex in SEX for part in ("alpha", "beta", "makeham")]
    return Given("gompertz", np.array(values), tuple(labels), "1", _square(6))


def _banded(
    section: Section, key: str, name: str, given: float | str, ages: range, low: float = 0.0
) -> Given:
    """A number for all, or a CSV sex,age,value: each value holds from its age on; index [2, G]."""
    unit = YEARLY if key == "improvement" else "1"
    if not isinstance(given, str):
        return Given(name, np.array([given]), ("",), unit, np.zeros((2, len(ages)), np.int64))
    return bands(Mention(section, key, given), "value", name, unit, ages, low)


def bands(
    mention: Mention, column: str, name: str, unit: str, ages: range, low: float = -np.inf
) -> Given:
    """Numbers by sex that hold from an age on; what no age of the table meets is left out."""
    rows = read_rows(mention, ("sex", "age", column))
    values, labels = [], []
    index = np.zeros((2, len(ages)), np.int64)
    for sex in (MALE, FEMALE):
        own = [row for row in rows if word(row, "sex", SEX) == SEX[sex]]
        begins = [_whole_age(row) for row in own]
        if not own or begins[0] > ages[0]:
            got = Unquoted(f"no value for {SEX[sex]} at {ages[0]}")
            raise mention.section.error(mention.key, got, f"{mention.name} must begin there")
        for row, before, here in zip(own[1:], begins[:-1], begins[1:]):
            if here <= before:
                raise row.error("age", f"ages must rise, and the row before has {before}")
        place = np.searchsorted(begins, np.array(ages), side="right") - 1
        for band in np.unique(place):
            index[sex, place == band] = len(values)
            values.append(own[band].number(column, low))
            labels.append(f"{SEX[sex]} from {begins[band]}" if len(own) > 1 else SEX[sex])
    return Given(name, np.array(values), tuple(labels), unit, index)


def read_lee_carter(
    section: Section, table: LeeCarterTable | None, mortality: Mortality
) -> LeeCarter | None:
    """The stochastic factor of mortality, where the case has one."""
    if table is None:
        return None
    ages = range(mortality.first_age, mortality.first_age + mortality.ages)
    mention = Mention(section, "file", table.file)
    return LeeCarter(
        volatility=single("lee_carter_volatility", table.volatility, SQUARE_ROOT),
        loading=bands(mention, "loading", "lee_carter_loading", "1", ages),
    )
