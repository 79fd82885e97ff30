"""Weights on payment nodes against the payments themselves, at every time."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from tests.domains.pension.people_cases import given, lee_carter, people_case, plan

from snapo.domains.pension.fund.schedule import basis_log_bond
from snapo.domains.pension.people.cash_flows import horizon, project
from snapo.domains.pension.people.liability import (
    _mean,
    forward_discount,
    nodes,
    on_nodes,
    people,
)
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability, Reconcile
from snapo.domains.pension.results.figures.reconcile import check, figures
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy


@with_numpy
def made(case, inputs=None):
    """People, projection and ln of discount factors by NumPy, which compiles nothing."""
    inputs = plain(pension_inputs(case)) if inputs is None else inputs
    log_bond = basis_log_bond(case, inputs)
    return people(case, inputs, log_bond), project(case, inputs, log_bond)[:3], log_bond


@pytest.fixture(scope="module", params=["advance", "arrears"])
def fund(request):
    case = people_case(24, plan=plan(timing=request.param))
    return case, *made(case)


@pytest.mark.prove
def test_nodes_are_months_then_years():
    months, whole = nodes(1 / 12), nodes(1.0)
    assert months[:8].tolist() == [0, 1, 3, 6, 12, 18, 24, 36] and months[-1] == 1200
    assert whole[:3].tolist() == [0, 1, 2] and whole[-1] == 100
    assert set(12 * whole) | {1, 3, 6, 18} == set(months)


@pytest.mark.prove
def test_values_on_nodes_are_the_exact_sums_at_every_time(fund):
    case, found, (accrued, fresh, _), log_bond = fund
    shift = int(case.plan.timing == "arrears")
    wages = np.exp(0.004 / 12 * np.arange(24))
    for t in (0, 7, 24):
        due = np.arange(t, t + 1200)
        discount = np.exp(log_bond[due + shift] - log_bond[t])
        assert found.accrued[t].sum() == pytest.approx(accrued[due] @ discount, rel=1e-12)
        rights = wages[:t] @ fresh[:t]
        assert found.fresh[t].sum() == pytest.approx(rights[due] @ discount, rel=1e-12, abs=0)
        if t < 24:
            assert found.accrual[t].sum() == pytest.approx(fresh[t, due] @ discount, rel=1e-12)
            assert found.fresh_benefit[t] == pytest.approx(rights[t], rel=1e-12, abs=0)
    np.testing.assert_array_equal(found.benefit, accrued[:25])
    assert not found.accrual[24].any() and found.mix[24] == 0


@pytest.mark.prove
def test_the_liability_rolls_forward_along_the_forward_curve(fund):
    """What is left is worth the forward value of today's less what was paid."""
    case, found, _, log_bond = fund
    growth = np.exp(log_bond[:24] - log_bond[1:25])
    value = (found.accrued + found.fresh).sum(1)
    new = found.baseline[:24] * found.accrual[:24].sum(1)
    paid = (found.benefit + found.fresh_benefit)[:24]
    early, late = (paid, 0) if case.plan.timing == "advance" else (0, paid)
    np.testing.assert_allclose(value[1:], (value[:24] + new - early) * growth - late, rtol=1e-11)


@pytest.mark.prove
def test_new_rights_are_exact_on_the_initial_curve_whatever_wages_do(fund):
    case, found, (_, fresh, _), log_bond = fund
    wages = np.exp(0.3 * np.sin(np.arange(24)))
    shift = int(case.plan.timing == "arrears")
    size = 1.0
    for t in range(24):
        size = (1 - found.mix[t]) * size + found.mix[t] * wages[t] / found.baseline[t]
        if t == 0:
            assert size == pytest.approx(wages[0])
    # Benefits paid meanwhile are those of the mean profile: hardly anything is due in two years.
    due = np.arange(24, 24 + 1200)
    exact = (wages @ fresh)[due] @ np.exp(log_bond[due + shift] - log_bond[24])
    assert size * found.fresh[24].sum() == pytest.approx(exact, rel=1e-4)


@pytest.mark.prove
def test_a_parallel_move_of_the_curve_is_interpolated_closely(fund):
    case, found, (accrued, _, _), log_bond = fund
    due = np.arange(1200) + int(case.plan.timing == "arrears")
    factor = np.exp(-0.01 * due / 12)
    exact = accrued[:1200] @ (np.exp(log_bond[due]) * factor)
    split = found.accrued[0] @ np.exp(-0.01 * nodes(1 / 12) / 12)
    assert split == pytest.approx(exact, rel=2e-5)


@pytest.mark.prove
def test_the_bases_of_valuation():
    rate = given("liability_rate", 0.01)
    flow = made(people_case())[1][0]
    for basis in ("spread", "fixed"):
        case = people_case(liability=Liability(basis, rate, "none"))
        found, _, log_bond = made(case)
        curve = made(people_case())[2] if basis == "spread" else 0.0
        expected = flow @ np.exp(curve - 0.01 / 12 * np.arange(len(log_bond)))[: len(flow)]
        assert found.accrued[0].sum() == pytest.approx(expected, rel=1e-10)


@pytest.fixture(scope="module")
def mortal():
    case = people_case(24, lee_carter=lee_carter())
    return case, *made(case)


def shifted(case, k):
    """The case's inputs with hazards times exp(loading k), the multiplier of q in them, by a new
    table."""
    inputs = plain(pension_inputs(case))
    loading = case.lee_carter.loading.used()
    q, multiplier = case.mortality.table.used(), case.mortality.multiplier.used()
    alive = np.maximum(1 - multiplier * q, 0.0)
    moved = (1 - alive ** np.exp(loading * k)) / multiplier
    return inputs | {"death_probability": moved.ravel()}


@pytest.mark.prove
def test_the_response_to_mortality_is_the_slope_of_a_full_revaluation(mortal):
    case, found, _, _ = mortal
    h = 1e-4
    up, down = (made(case, shifted(case, k))[0].accrued[0] for k in (h, -h))
    slope = (up - down) / (2 * h)
    np.testing.assert_allclose(-found.outlook[0] * found.accrued[0], slope, rtol=1e-6, atol=1e-4)
    assert slope.sum() == pytest.approx(-(found.outlook[0] * found.accrued[0]).sum(), rel=1e-6)


@pytest.mark.prove
def test_mortality_that_is_realised_and_that_is_expected_add_up(mortal):
    """A factor known at time 0 moves the liability alike, whether looked at then or later."""
    _, found, (accrued, _, _), log_bond = mortal
    value = np.exp(log_bond[: len(accrued)]) * accrued
    ahead = np.cumsum(value[::-1])[::-1]
    slope = (found.outlook * found.accrued).sum(1) * np.exp(log_bond[:25])
    # The fall counts what the step itself accrues too, a thousandth of all rights.
    assert slope[0] == pytest.approx(found.decline[0] * ahead[1] + slope[1], rel=1e-3)
    assert np.all(found.decline[:24] > 0) and np.all(found.outlook >= -1e-12)


@pytest.mark.prove
def test_figures_are_exact_sums_and_their_slopes():
    case = people_case()
    inputs = plain(pension_inputs(case))
    found = figures(case, inputs)
    _, (flow, _, _), log_bond = made(case)
    value, years = flow * np.exp(log_bond[: len(flow)]), np.arange(len(flow)) / 12
    assert found.liability == pytest.approx(value.sum(), rel=1e-13)
    assert found.duration == pytest.approx(value @ years / value.sum(), rel=1e-12)
    assert found.convexity == pytest.approx(value @ years**2 / value.sum(), rel=1e-12)
    for node in range(5):
        bumped = [inputs["zero_rate"] + sign * 1e-5 * np.eye(5)[node] for sign in (1, -1)]
        up, down = (figures(case, inputs | {"zero_rate": each}).liability for each in bumped)
        assert found.key_rate[node] == pytest.approx((up - down) / 2e-5 * 1e-4, rel=1e-7)
    assert found.key_rate.sum() == pytest.approx(
        -1e-4 * found.duration * found.liability, rel=1e-12
    )
    assert found.inflation01 == 0
    real = replace(case, liability=Liability("risk-free", given("liability_rate", 0.0), "full"))
    other = figures(real, plain(pension_inputs(real)))
    assert other.inflation01 == pytest.approx(1e-4 * other.duration * other.liability, rel=1e-12)


@pytest.mark.prove
def test_reconciliation_says_what_is_met_and_what_is_missed():
    case = people_case()
    inputs = plain(pension_inputs(case))
    value = figures(case, inputs).liability
    asked = Reconcile(value * 1.0005, 5.0, 0.001)
    lines = {line.name: line for line in check(replace(case, reconcile=asked), inputs)}
    assert lines["liability"].ok and lines["liability"].error == pytest.approx(-5e-4, rel=1e-2)
    assert not lines["duration"].ok and lines["duration"].given == 5.0
    assert lines["liability on payment nodes"].ok and lines["sum of key rates"].ok
    unasked = {line.name: line for line in check(replace(case, held=("zero_rate",)), inputs)}
    assert unasked["liability"].given is None and unasked["sum of key rates"].ok


@pytest.mark.prove
def test_an_empty_fund_has_no_value_and_finite_weights():
    case = people_case(members=replace(people_case().members, number=given("members", np.zeros(5))))
    found = made(replace(case, lee_carter=lee_carter()))[0]
    assert all(np.all(np.isfinite(each)) for each in jax.tree.leaves(found))
    assert found.accrued.sum() == 0
    discount = with_numpy(forward_discount)(case, np.zeros(horizon(case) + 1))
    value = with_numpy(on_nodes)(case, np.zeros(horizon(case)), discount)
    assert value.shape == (7, len(nodes(1 / 12)))


@pytest.mark.parametrize("weight", [0.0, 1e-320, 1e-200, 1e-100, 2.0])
def test_a_mean_over_people_who_are_surely_dead_has_a_derivative(weight):
    """Of an open plan with exact ages and Lee-Carter mortality, twelve inputs had NaN."""
    with jax.enable_x64(True):
        by_total, by_weight = jax.grad(lambda t, w: _mean(3 * t, w) + w, (0, 1))(weight, weight)
    due = weight > 1e-150
    np.testing.assert_allclose(by_total, 3 / weight if due else 0.0, rtol=1e-14)
    np.testing.assert_allclose(by_weight, 1 - 3 / weight if due else 1.0, rtol=1e-14)
