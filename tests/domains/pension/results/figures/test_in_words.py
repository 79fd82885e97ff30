"""What `check` says of a plan in words, and the loading for expenses."""

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, MARKET, written
from tests.domains.pension.people_cases import given, people_case

from snapo.domains.pension.fund.schedule import basis_log_bond
from snapo.domains.pension.people.liability import people
from snapo.domains.pension.read.case import resolve
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.results.figures.in_words import in_words
from snapo.domains.pension.results.figures.reconcile import check, figures
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy


def said(folder, **changes):
    return "\n".join(in_words(resolve(written(folder), MARKET | changes)))


def test_accrual_and_increases_are_said_by_status(tmp_path):
    data = {key: value for key, value in CASES["increases apart"].items() if key != "plan"}
    plan = CASES["increases apart"]["plan"] | {"accrual_rate": 0.02}
    text = said(tmp_path, **(data | {"plan": plan}))
    assert "career average, 2.00% of salary for a year of service" in text
    assert "revalued in service by 1.00% a year" in text
    assert "in payment 3.00% a year, deferred rights 2.50%, rights in service 1.00%" in text
    assert "with 3.00% for expenses" in text
    fixed = {"indexation": {"kind": "fixed", "rate": 0.03}, "accrual_rate": 0.02}
    text = said(tmp_path, plan=fixed)
    every = "pensions in payment, deferred rights and rights in service"
    assert f"3.00% a year, the same for {every}" in text
    assert "revalued in service as pensions in payment" in text


@pytest.mark.parametrize("name", [n for n in CASES if n != "cash flows"])
def test_every_case_has_its_words(name, tmp_path):
    data = {key: value for key, value in CASES[name].items() if value is not None}
    lines = in_words(resolve(written(tmp_path), data))
    assert [line.partition(":")[0] for line in lines][:2] == ["accrual", "increases"]
    assert all("nan" not in line and "None" not in line for line in lines)


def test_the_expectation_of_life_shows_deaths_that_are_twice_as_many(tmp_path):
    data = {key: entry for key, entry in CASES["index-linked"].items() if entry is not None}
    twice = data | {"mortality": data["mortality"] | {"multiplier": 1.9}}
    assert "life expectancy at 65: men 19.2 years, women 22.9" in said(tmp_path, **data)
    assert "life expectancy at 65: men 13.5 years, women 16.9" in said(tmp_path, **twice)


@pytest.mark.prove
def test_a_loading_reserves_a_share_of_every_payment_and_pays_none_of_it():
    rate, loading = given("liability_rate", 0.0), given("liability_expense_loading", 0.03)
    bare = people_case(6, liability=Liability("risk-free", rate, "none"))
    full = people_case(6, liability=Liability("risk-free", rate, "none", loading=loading))
    inputs = plain(pension_inputs(full))
    one, other = (
        with_numpy(people)(each, inputs, with_numpy(basis_log_bond)(each, inputs))
        for each in (bare, full)
    )
    for key in ("accrued", "fresh", "accrual"):
        np.testing.assert_allclose(
            getattr(other, key), 1.03 * np.asarray(getattr(one, key)), rtol=1e-13
        )
    for key in ("benefit", "fresh_benefit", "mix", "payroll"):
        np.testing.assert_allclose(getattr(other, key), getattr(one, key), rtol=1e-13)


@pytest.mark.prove
def test_figures_hold_the_loading():
    rate, loading = given("liability_rate", 0.0), given("liability_expense_loading", 0.03)
    bare = people_case(6, liability=Liability("risk-free", rate, "none"))
    full = people_case(6, liability=Liability("risk-free", rate, "none", loading=loading))
    one, other = (figures(each, plain(pension_inputs(each))) for each in (bare, full))
    assert other.liability == pytest.approx(1.03 * one.liability, rel=1e-13)
    assert other.duration == pytest.approx(one.duration, rel=1e-13)
    np.testing.assert_allclose(other.key_rate, 1.03 * one.key_rate, rtol=1e-12)
    np.testing.assert_allclose(other.cash_flow, one.cash_flow, rtol=1e-12)
    assert all(line.ok for line in check(full, plain(pension_inputs(full))))
