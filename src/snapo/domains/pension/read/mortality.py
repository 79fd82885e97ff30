"""Reads `[mortality]` and `[lee_carter]`: death rates by sex and age, and their random factor."""

import datetime
from dataclasses import replace

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import CaseInput, FilePosition
from snapo.case.quantity import ANY, FRACTION, Range, quantity_of
from snapo.case.table import TableContext

from ..quantities import AMOUNT, FundQuantity, input_of
from ..records.people import FEMALE, MALE, SLOPE_AGES, LeeCarter, Mortality
from .cells import TableReader, empty, word
from .tables_people import LeeCarterTable, MortalityTable

SEX = ("male", "female")
RATIO = AMOUNT.of("people", unit="1", range=ANY)
PROBABILITY = RATIO.in_column("q", "a death probability rises by a relative 1 %", range=FRACTION)
FORMULA = replace(RATIO, meaning="a parameter of the mortality formula rises by a relative 1 %")
LOADING = RATIO.in_column(
    "loading", "how strongly the hazard of an age responds to the mortality factor"
)
LAST_AGE = 120  # of a formula, and of a table that is closed
FORMULA_AGES = (16, LAST_AGE - 16 + 1)  # first age and number of ages of a formula
OLD = 110  # a table that ends here or later, or at a probability of `HALF`, is used unchanged
HALF = 0.5  # a death probability at which nearly all are dead soon
FEWEST = 10  # ages of a table that can be closed


def read_mortality(section: TableReader, table: MortalityTable, start: datetime.date) -> Mortality:
    """Death probabilities by sex and age, or by the Gompertz-Makeham formula, with multipliers and
    improvement. Improvement counts from `year` of the table on, or without it from the valuation
    date `start`."""
    if table.kind == "table":
        for key in ("male", "female"):
            if getattr(table, key) is not None:
                raise section.error(key, getattr(table, key), 'kind "table" has no such key')
        if table.file is None:
            raise section.error("file", None, 'kind "table" needs this key')
        first, probability = _table(section, table.file)
        count = _ages(section, table.file, first, probability.used())
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
        multiplier=_banded(section, table, "multiplier", ages, Range(0.0)),
        improvement=_banded(section, table, "improvement", ages, Range(-1.0)),
        since=_since(section, table, start),
    )


def _since(section: TableReader, table: MortalityTable, start: datetime.date) -> float:
    """Years of improvement up to time 0, and a remark where something about them was left out."""
    improvement, day = table.improvement, start + datetime.timedelta(15)
    improves = isinstance(improvement, str) or improvement.used() != 0
    now = day.year + (day.month - 1) / 12  # time 0 begins a month
    if table.year is None:
        if improves:
            section.notes.append(
                "mortality.year is left out: improvement counts from the valuation date on, as if"
                " the death probabilities were those of that year."
            )
        return 0.0
    if not improves and now > table.year:
        section.notes.append(
            f"mortality.improvement is left out: the death probabilities of {table.year} are used"
            f" unchanged, {now - table.year:.3g} years later."
        )
    return now - table.year


def _ages(section: TableReader, file: str, first: int, q: np.ndarray) -> int:
    """The number of ages: those of the table, or up to `LAST_AGE` where it ends before nearly all
    are dead. Such a table is closed by the slope of its oldest ages, see `Mortality`."""
    count = q.shape[1]
    last = first + count - 1
    if last >= OLD or q[:, -1].min() >= HALF:
        return count
    got = Unquoted(f"the ages {first} to {last}")
    if count < FEWEST:
        message = (
            f"a table that ends before age {OLD} must have at least {FEWEST} ages, so that "
            "it can be extrapolated"
        )
        raise section.error("file", got, message)
    oldest = q[:, -SLOPE_AGES:]
    ages = f"{last + 1 - oldest.shape[1]} to {last}"
    position = np.arange(oldest.shape[1]) - (oldest.shape[1] - 1) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        rises = np.log(oldest) @ position > 0
    if not rises.all() or not (oldest.max() < HALF):
        message = (
            f"a table that ends before age {OLD} is extrapolated from its oldest ages, but the "
            f"death probabilities do not rise, or reach {HALF:g}, at the ages {ages}"
        )
        raise section.error("file", got, message)
    section.notes.append(
        f"{file} ends at age {last}: it is extrapolated to {last + 1} to {LAST_AGE}, where "
        f"the logit of the hazard rises as at the ages {ages} (Kannisto)."
    )
    return LAST_AGE - first + 1


def _table(section: TableContext, file: str) -> tuple[int, CaseInput]:
    """First age and q [2, G]: both sexes, every age from the first to the last."""
    rows = read_rows(FileReference(section, "file", file), ("sex", "age", "q"))
    cells: dict[tuple[int, int], Row] = {}
    for row in rows:
        key = SEX.index(word(row, "sex", SEX)), _whole_age(row)
        if key in cells:
            raise row.error("age", "an earlier row has this age already")
        cells[key] = row
    ages = sorted({age for _, age in cells})
    for sex in (MALE, FEMALE):
        for age in range(ages[0], ages[-1] + 1):
            if (sex, age) not in cells:
                got = Unquoted(f"no row for {SEX[sex]}, {age}")
                message = f"both sexes need every age from {ages[0]} to {ages[-1]}"
                raise section.error("file", got, f"{message} in {file}")
    order = [(sex, age) for sex in (MALE, FEMALE) for age in range(ages[0], ages[-1] + 1)]
    labels, ordered = [f"{SEX[sex]} {age}" for sex, age in order], [cells[key] for key in order]
    index = _square(len(order))
    return ages[0], PROBABILITY.from_rows("death_probability", ordered, labels, index=index)


def _square(count: int) -> np.ndarray:
    return np.arange(count).reshape(2, -1)


def _whole_age(row: Row) -> int:
    age = row.number("age", 0.0, 150.0)
    if age != int(age):
        raise row.error("age", "it must be a whole number of years")
    return int(age)


def _gompertz(section: TableContext, table: MortalityTable) -> CaseInput:
    """alpha, beta and makeham by sex [2, 3]."""
    values: list[float] = []
    positions: list[FilePosition] = []
    for key in SEX:
        inputs = getattr(table, key)
        if inputs is None:
            raise section.error(key, None, f'kind "{table.kind}" needs this key')
        alpha, beta, makeham = (*inputs, 0.0)[:3]
        if beta <= 0 or makeham < 0:
            raise section.error(key, inputs, "beta must be above 0 and makeham at least 0")
        values += [alpha, beta, makeham]
        positions += [(*section.keys, key, i) if i < len(inputs) else None for i in range(3)]
    labels = [f"{sex} {part}" for sex in SEX for part in ("alpha", "beta", "makeham")]
    return FORMULA.input("gompertz", values, labels, index=_square(6), positions=tuple(positions))


def _banded(
    section: TableReader,
    table: MortalityTable,
    key: str,
    ages: range,
    in_file: Range,
) -> CaseInput:
    """A number for all, or a CSV sex,age,value in which a value applies from its age on; index [2,
    G].

    `in_file`: the numbers that the CSV may have.
    """
    numbers = getattr(table, key)
    if isinstance(numbers, str):
        declared = quantity_of(type(table).model_fields[key])
        assert isinstance(declared, FundQuantity)
        reference = FileReference(section, key, numbers)
        return bands(reference, declared.name or key, ages, replace(declared, range=in_file))
    index = np.zeros((2, len(ages)), np.int64)
    return section.input(table, key, replace(numbers, index=index))


def bands(reference: FileReference, name: str, ages: range, quantity: FundQuantity) -> CaseInput:
    """Numbers by sex that apply from an age on; a number that applies to no age of the table is
    omitted."""
    rows = read_rows(reference, ("sex", "age", quantity.column))
    used, labels = [], []
    index = np.zeros((2, len(ages)), np.int64)
    for sex in (MALE, FEMALE):
        local = [row for row in rows if word(row, "sex", SEX) == SEX[sex]]
        begins = [_whole_age(row) for row in local]
        if not local or begins[0] > ages[0]:
            got = Unquoted(f"no value for {SEX[sex]} at {ages[0]}")
            message = f"{reference.name} must begin at or below this age"
            raise reference.section.error(reference.key, got, message)
        for row, before, here in zip(local[1:], begins[:-1], begins[1:]):
            if here <= before:
                raise row.error("age", f"ages must increase; the previous row has {before}")
        position = np.searchsorted(begins, np.array(ages), side="right") - 1
        for band in np.unique(position):
            index[sex, position == band] = len(used)
            used.append(local[band])
            labels.append(f"{SEX[sex]} from {begins[band]}" if len(local) > 1 else SEX[sex])
    return quantity.from_rows(name, used, labels, index=index)


def read_lee_carter(
    section: TableContext, table: LeeCarterTable | None, mortality: Mortality
) -> LeeCarter | None:
    """The stochastic factor of mortality, if the case has one."""
    if table is None:
        return None
    ages = range(mortality.first_age, mortality.first_age + mortality.ages)
    reference = FileReference(section, "file", table.file)
    return LeeCarter(
        volatility=input_of(table, "volatility", "lee_carter"),
        loading=bands(reference, "lee_carter_loading", ages, LOADING),
    )
