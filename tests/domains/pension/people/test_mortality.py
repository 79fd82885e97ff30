"""Survival against the death probabilities of a year, and annuities of a published table."""

import csv
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.people_cases import (
    AGES,
    FIRST_AGE,
    GOMPERTZ,
    given,
    gompertz_table,
    members,
    mortality,
    nothing,
    people_case,
    plan,
)

from snapo.domains.pension.people.liability import people
from snapo.domains.pension.people.longer_life import life_expectancy, year_of_life
from snapo.domains.pension.people.mortality import hazard, log_survival, rounded_age
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.people import FEMALE, MALE, PENSIONER, Mortality
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy

TABLE = Path(__file__).parents[4] / "shared" / "data" / "ssa_period_life_table_2017.csv"
# Annuities-due on that table at 2.3 %: yearly payments in advance at 60, 65, 70 and 80, to 1e-4.
ANNUITIES = {
    MALE: (16.8823, 14.6344, 12.3139, 7.7997),
    FEMALE: (18.6827, 16.2926, 13.8036, 8.8990),
}


def annuity_due(probability: np.ndarray, age: int, rate: float) -> float:
    """Value of 1 a year in advance for life: sum of v^k kp_x, v = 1 / (1 + rate).

    `probability`: q by age from 0 on; the last age is not survived.
    """
    survival = np.concatenate([[1.0], np.cumprod(1 - np.asarray(probability)[age:])])
    return float(np.sum(survival * (1 + rate) ** -np.arange(len(survival))))


@with_numpy
def survival(case, sex, age, steps):
    inputs = plain(pension_inputs(case))
    return np.exp(log_survival(case, inputs, np.array([sex]), np.array([age]), steps))[0]


def probability(sex, age, year):
    """q of the calendar year, from the definition in `records.people.Mortality`."""
    multiplier = [0.9, 1.0, 0.95, 1.05][2 * sex + (age >= FIRST_AGE + 45)]
    q = multiplier * gompertz_table()[sex, age - FIRST_AGE]
    return 1 - (1 - q) ** np.exp(-[0.012, 0.01][sex] * year)


@pytest.mark.parametrize("fractional", ["constant-force", "uniform"])
@pytest.mark.parametrize("step", [1 / 12, 1.0])
def test_whole_years_have_the_death_probabilities_of_the_table(step, fractional):
    case = people_case(step=step, plan=plan(fractional_ages=fractional))
    each = round(1 / step)
    found = survival(case, FEMALE, 63.0, 10 * each)[::each]
    expected = np.cumprod([1 - probability(FEMALE, 63 + j, j) for j in range(10)])
    np.testing.assert_allclose(found[1:], expected, rtol=1e-12)


def test_within_a_year_deaths_are_uniform_or_of_constant_force():
    q = probability(MALE, 80, 0)
    months = np.arange(13) / 12
    uniform = people_case(plan=plan(fractional_ages="uniform"))
    np.testing.assert_allclose(survival(uniform, MALE, 80.0, 12), 1 - months * q, rtol=1e-12)
    constant = survival(people_case(), MALE, 80.0, 12)
    np.testing.assert_allclose(constant, (1 - q) ** months, rtol=1e-12)


@pytest.mark.parametrize("fractional", ["constant-force", "uniform"])
def test_a_step_across_a_birthday_is_divided_there(fractional):
    case = people_case(plan=plan(fractional_ages=fractional, age_basis="exact"))
    found = survival(case, MALE, 70.55, 6)
    old, new = probability(MALE, 70, 0), probability(MALE, 71, 0)
    if fractional == "uniform":
        expected = (1 - old) / (1 - 0.55 * old) * (1 - 0.05 * new)
    else:
        expected = (1 - old) ** 0.45 * (1 - new) ** 0.05
    assert found[6] == pytest.approx(expected, rel=1e-12)


@pytest.mark.prove
def test_the_last_age_holds_for_later_ages_and_certain_death_ends_all_lives():
    table = gompertz_table()[:, :70]
    held = people_case(step=1.0, mortality=mortality(table=table))
    found = survival(held, MALE, 95.0, 4)
    ratio = np.log(found[1:] / found[:-1])
    np.testing.assert_allclose(ratio[1:] / ratio[:-1], np.exp(-0.012), rtol=1e-12)
    certain = people_case(step=1.0)
    assert survival(certain, MALE, float(FIRST_AGE + AGES - 1), 1)[1] < 1e-20


def test_gompertz_makeham_is_the_integral_of_its_force():
    formula = np.concatenate([GOMPERTZ[:, :2], [[0.0005], [0.0003]]], axis=1)
    law = mortality("gompertz-makeham", gompertz=given("gompertz", formula))
    case = people_case(mortality=law)
    found = with_numpy(hazard)(case, plain(pension_inputs(case)))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for sex in (MALE, FEMALE):
        alpha, beta, makeham = formula[sex]
        force = makeham + np.exp(alpha + beta * (65 + (nodes + 1) / 2))
        assert found[sex, 65 - FIRST_AGE] == pytest.approx(force @ weights / 2, rel=1e-13)


def test_ages_are_rounded_as_the_valuation_says():
    ages = np.array([40.2, 40.5, 40.9])
    for basis, expected in (("nearest", [40, 41, 41]), ("last", [40, 40, 40]), ("exact", ages)):
        found = with_numpy(rounded_age)(plan(age_basis=basis), ages)
        np.testing.assert_array_equal(found, expected)


def published() -> np.ndarray:
    """Death probabilities [2, ages] of the US period life table 2017."""
    if not TABLE.exists():
        pytest.skip(f"{TABLE.name} is not beside the repository")
    rows = list(csv.DictReader(TABLE.read_text().splitlines()))
    sexes = ("male", "female")
    return np.array(
        [[float(row["death_probability"]) for row in rows if row["sex"] == sex] for sex in sexes]
    )


def published_law() -> Mortality:
    """That table, without improvement."""
    table = published()
    return replace(
        mortality(table=table),
        first_age=0,
        multiplier=given("mortality_multiplier", [1.0], np.zeros(table.shape, int)),
        improvement=nothing("improvement", table.shape),
    )


def test_expectations_of_life_of_the_published_table():
    """Its own column of them: the agency publishes two decimals, its l_x being rounded."""
    case = people_case(mortality=published_law())
    inputs = plain(pension_inputs(case))
    for sex, at_birth, at_65 in ((MALE, 75.97, 17.92), (FEMALE, 80.96, 20.49)):
        assert life_expectancy(case, inputs, sex, 0) == pytest.approx(at_birth, abs=0.01)
        assert life_expectancy(case, inputs, sex, 65) == pytest.approx(at_65, abs=0.01)


def test_annuities_of_the_published_table():
    table, law = published(), published_law()
    for sex, expected in ANNUITIES.items():
        count = len(expected)
        lives = members(
            names=tuple("abcd"),
            status=np.full(count, PENSIONER),
            sex=np.full(count, sex),
            age=np.array([60.0, 65.0, 70.0, 80.0]),
            number=given("members", np.ones(count)),
            pension=given("accrued_pension", np.ones(count)),
            salary=nothing("salary", (count,)),
            service=np.zeros(count),
        )
        terms = plan(spouse_share=nothing("plan_spouse_share"), accruing=False)
        case = people_case(step=1.0, steps=2, members=lives, mortality=law, plan=terms)
        inputs = plain(pension_inputs(case))
        log_bond = -np.log(1.023) * np.arange(103)

        def value(pension, case=case, inputs=inputs, log_bond=log_bond):
            given = inputs | {"accrued_pension": pension}
            return people(case, given, jnp.asarray(log_bond)).accrued[0].sum()

        with jax.enable_x64(True):
            each = np.asarray(jax.grad(value)(jnp.ones(count)))
        np.testing.assert_allclose(each, expected, rtol=0, atol=1e-4)
        direct = [annuity_due(table[sex], age, 0.023) for age in (60, 65, 70, 80)]
        np.testing.assert_allclose(each, direct, rtol=1e-10)


def test_a_year_of_life_is_a_year_of_life():
    case = people_case()
    inputs = plain(pension_inputs(case))
    scale = year_of_life(case, inputs, FEMALE)
    assert 0.85 < scale < 0.95
    moved = inputs | {"mortality_multiplier": scale * inputs["mortality_multiplier"]}
    before, after = (life_expectancy(case, each, FEMALE, 65) for each in (inputs, moved))
    assert after - before == pytest.approx(1.0, abs=1e-9)
