"""A table's year, its end and factors on its probabilities, against sums written out."""

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, written
from tests.domains.pension.people_cases import given, gompertz_table, mortality, people_case

from snapo.case.error import CaseError
from snapo.domains.pension.people.mortality import log_survival
from snapo.domains.pension.read.case import resolve
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.people import FEMALE, MALE
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy

SEXES = ("male", "female")


@with_numpy
def survival(case, sex, age, years):
    inputs = plain(pension_inputs(case))
    return np.exp(log_survival(case, inputs, np.array([sex]), np.array([age]), years))[0]


def file_of(q, first=20, sexes=SEXES):
    """A table of death probabilities [sex, age] as a file."""
    rows = [f"{sex},{first + i},{x:.12g}" for sex, row in zip(sexes, q) for i, x in enumerate(row)]
    return "sex,age,q\n" + "\n".join(rows) + "\n"


def case_with(folder, q, cohorts="P,pensioner,male,65,1,1,,\n", head="", **changes):
    """A fund of pensioners at 3 % a year, paid yearly, with the table `q` from age 20 on."""
    file = written(folder)
    (folder / "own.csv").write_text(file_of(q))
    (folder / "cohorts.csv").write_text(
        f"name,status,sex,age,number,pension,salary,service{head}\n{cohorts}"
    )
    data = {key: value for key, value in CASES["everything"].items() if key in (
        "kind", "curve", "inflation", "rates", "assets", "credit", "currencies")}  # fmt: skip
    fund = CASES["increases apart"]["fund"] | {"step": "year"}
    data |= {"members": {"file": "cohorts.csv"}, "fund": fund}
    data["mortality"] = {"kind": "table", "file": "own.csv"} | changes
    data["plan"] = {"timing": "advance", "indexation": {"kind": "none"}}
    data["liability"] = {"basis": "fixed", "rate": 0.03}
    return resolve(file, data)


def value(case):
    return figures(case, plain(pension_inputs(case))).liability


def annuity(q, rate, count=60):
    """Yearly payments in advance to someone who dies with `q` in each year."""
    alive = np.concatenate([[1.0], np.cumprod(1 - np.asarray(q)[: count - 1])])
    return float(np.sum(alive * (1 + rate) ** -np.arange(len(alive))))


@pytest.fixture
def whole():
    """A table to age 119 whose hazard follows a Gompertz law."""
    age = np.arange(20, 120)
    hazard = np.exp(np.array([[-10.4], [-11.5]]) + np.array([[0.096], [0.105]]) * age)
    return -np.expm1(-hazard)


@pytest.mark.parametrize(("year", "since"), [(2017, 8.0), (2025, 0.0), (None, 0.0)])
def test_improvement_counts_from_the_table_s_year(year, since, tmp_path, whole):
    """Valued at the end of 2024, so from 2025 on."""
    given_year = {} if year is None else {"year": year}
    case = case_with(tmp_path, whole, improvement=0.02, **given_year)
    trend = np.exp(-0.02 * (since + np.arange(10)))
    q = 1 - (1 - whole[MALE, 45:55]) ** trend
    assert survival(case, MALE, 65.0, 10)[1:] == pytest.approx(np.cumprod(1 - q), rel=1e-10)
    assert any("mortality.year" in note for note in case.notes) == (year is None)


def test_a_table_without_improvement_and_with_a_year_says_how_old_it_is(tmp_path, whole):
    case = case_with(tmp_path, whole, year=2017)
    assert any("2017" in note and "improvement" in note for note in case.notes)


def test_a_multiplier_scales_the_probability_of_a_year(tmp_path, whole):
    case = case_with(tmp_path, whole, multiplier=0.75)
    q = np.minimum(0.75 * whole[MALE, 45:], 1.0)
    assert value(case) == pytest.approx(annuity(q, 0.03), rel=1e-8)


def test_a_certain_death_stays_certain_and_no_probability_exceeds_one():
    table = gompertz_table()
    for factor in (0.5, 1.8):
        law = mortality(
            table=table,
            multiplier=given("mortality_multiplier", [factor], np.zeros(table.shape, int)),
        )
        found = survival(people_case(step=1.0, mortality=law), MALE, 105.0, 6)
        assert found[-1] < 1e-15, factor


@pytest.mark.parametrize("last", [80, 90, 100])
def test_a_table_that_stops_early_is_closed_as_the_oldest_ages_rise(last, tmp_path, whole):
    """Logits of hazards that rise linearly: of a logistic law exactly, of another closely."""
    age = np.arange(20, 120)
    odds = np.exp(np.array([[-11.0], [-11.8]]) + np.array([[0.105], [0.11]]) * age)
    logistic = -np.expm1(-odds / (1 + odds))
    for name, table, close in (("logistic", logistic, 1e-9), ("gompertz", whole, 0.03)):
        folder = tmp_path / name
        folder.mkdir()
        case = case_with(folder, table[:, : last - 20 + 1])
        rate = 0.03
        found = value(case)
        assert found == pytest.approx(annuity(table[MALE, 45:], rate), rel=close), name
        assert any(f"{last + 1} to 120" in note for note in case.notes)
        held = np.append(table[MALE, 45 : last - 19], np.full(60, table[MALE, last - 20]))
        assert found < annuity(held, rate)


def test_a_table_that_ends_where_nearly_all_are_dead_is_used_as_it_is(tmp_path, whole):
    case = case_with(tmp_path, whole)
    assert case.mortality.ages == 100
    assert not any("closed" in note for note in case.notes)


def test_a_table_that_cannot_be_closed_is_refused(tmp_path, whole):
    falling = whole[:, :61].copy()
    falling[:, -20:] = falling[:, -20:][:, ::-1]
    with pytest.raises(CaseError, match=r"mortality.file.*do not rise.*61 to 80"):
        case_with(tmp_path, falling)
    with pytest.raises(CaseError, match=r"mortality.file.*ages 20 to 25.*at least 10"):
        case_with(tmp_path, whole[:, :6], cohorts="P,pensioner,male,22,1,1,,\n")


def test_cohorts_may_have_a_factor_of_their_own(tmp_path, whole):
    rows = "A,pensioner,male,65,1,1,,,0.8\nB,pensioner,female,70,1,1,,,\n"
    case = case_with(tmp_path, whole, cohorts=rows, head=",mortality", multiplier=0.9)
    rate = 0.03
    q = np.minimum(0.9 * np.array([0.8, 1.0])[:, None] * whole, 1.0)
    expected = annuity(q[MALE, 45:], rate) + annuity(q[FEMALE, 50:], rate)
    assert value(case) == pytest.approx(expected, rel=1e-8)
    assert "member_mortality" in pension_inputs(case)
