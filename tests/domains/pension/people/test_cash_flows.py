"""Expected payments against sums over people written out."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pension.people_cases import (
    cash_flows,
    given,
    lee_carter,
    members,
    nothing,
    people_case,
    plan,
)

from snapo.domains.pension.people.cash_flows import horizon, project
from snapo.domains.pension.people.lives import entrants, present, working
from snapo.domains.pension.people.mortality import log_survival
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.people import MALE, PENSIONER, SPOUSE
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy

# By NumPy, as a check evaluates these equations: JAX would compile every operation anew for the
# shapes of each case. The tests of the adjoint evaluate them by JAX.


@with_numpy
def projected(case):
    log_bond = -0.02 * case.step * np.arange(horizon(case) + 1)
    return project(case, plain(pension_inputs(case)), log_bond)


@with_numpy
def alive(case, sex, age):
    inputs = plain(pension_inputs(case))
    return np.exp(log_survival(case, inputs, np.array([sex]), np.array([age]), horizon(case)))[0]


@pytest.mark.prove
@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_payments_of_every_cohort_written_out(timing):
    case = people_case(plan=plan(timing=timing))
    found, group = projected(case), case.members
    count, shift = horizon(case), int(timing == "arrears")
    expected = np.zeros(count)
    for i in range(len(group.names)):
        sex, age, status = (int(each[i]) for each in (group.sex, group.age, group.status))
        own = alive(case, sex, float(age))
        other = alive(case, 1 - sex, float(age + (3 if sex else -3)))
        money = group.number.used()[i] * group.pension.used()[i] / 12
        for m in range(count):
            drawn = status in (PENSIONER, SPOUSE) or age + m // 12 >= 67
            at = m + shift
            expected[m] += money * own[at] * drawn
            if status != SPOUSE:
                expected[m] += money * 0.7 * 0.65 * other[at] * (1 - own[at])
    np.testing.assert_allclose(found.accrued, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.prove
def test_what_a_step_accrues_written_out():
    case = people_case()
    found, group = projected(case), case.members
    t, m = 4, 400
    expected = 0.0
    for i in (0, 1):
        sex, age = int(group.sex[i]), float(group.age[i])
        own, other = alive(case, sex, age), alive(case, 1 - sex, age + (3 if sex else -3))
        money = group.number.used()[i] * 0.0175 / 12 * (group.salary.used()[i] - 15) / 12
        expected += money * own[m] * (age + m / 12 >= 67)
        # Of those alive when it is accrued, the part that died since leaves a spouse.
        expected += money * 0.7 * 0.65 * (own[t] - own[m]) * other[m]
    assert found.fresh[t, m] == pytest.approx(expected, rel=1e-12)
    assert not found.fresh[t, : t + 1].any()


@pytest.mark.prove
def test_salaries_fall_as_actives_leave_and_stay_in_an_open_plan():
    closed, opened = (projected(people_case(15, plan=plan(open=each))) for each in (False, True))
    case = people_case()
    own = alive(case, MALE, 35.0)[13] * 100 * 40 + alive(case, 1, 62.0)[13] * 80 * 45
    assert closed.payroll[13] == pytest.approx(own / 12, rel=1e-12)
    np.testing.assert_allclose(opened.payroll, (100 * 40 + 80 * 45) / 12, rtol=1e-12)
    # Entrants count from the first month of the second year.
    np.testing.assert_allclose(opened.fresh[:12], closed.fresh[:12], rtol=1e-12)
    assert np.all(opened.fresh[12:].sum(1) > closed.fresh[12:].sum(1))


@pytest.mark.prove
def test_an_open_plan_keeps_its_pensionable_salary_at_the_start_of_every_year():
    case = people_case(12, step=1.0, plan=plan(open=True))
    inputs = plain(pension_inputs(case))
    lives = with_numpy(present)(case, inputs, case.members, horizon(case))
    new = with_numpy(entrants)(case, inputs, lives, horizon(case))
    force = [
        (each.base[:, None] * each.alive[:, :12] * with_numpy(working)(case, each, 12)).sum(0)
        for each in (lives, new)
    ]
    np.testing.assert_allclose(sum(force), force[0][0], rtol=1e-12)
    assert force[1][5] > force[1][4] * 2  # the older cohort retires after five years


@pytest.mark.prove
def test_accrual_ends_with_retirement_and_with_the_longest_service():
    found = projected(people_case(72, plan=plan(spouse_share=nothing("plan_spouse_share"))))
    ended = projected(
        people_case(72, plan=plan(max_service=25.25, spouse_share=nothing("plan_spouse_share")))
    )
    total = found.fresh.sum(1)
    assert total[60] < 0.6 * total[59]
    np.testing.assert_allclose(ended.fresh[:3], found.fresh[:3])
    np.testing.assert_allclose(ended.fresh[3:60].sum(1) < found.fresh[3:60].sum(1), True)
    frozen = projected(people_case(plan=plan(accruing=False)))
    assert not frozen.fresh.any()


@pytest.mark.prove
def test_salaries_below_the_offset_accrue_nothing():
    poor = members(salary=given("salary", [10.0, 12.0], [0, 1, 0, 0, 0]))
    assert not projected(people_case(members=poor)).fresh.any()


@pytest.mark.prove
def test_given_cash_flows_and_their_normal_cost():
    flows = cash_flows([10.0, 20.0, 30.0], [0, 12, 30], normal_cost=2.0, salary=120.0)
    case = people_case(members=None, mortality=None, cash_flows=flows)
    found = projected(case)
    assert found.accrued[[0, 12, 30]].tolist() == [10, 20, 30] and found.accrued.sum() == 60
    discount = np.exp(-0.02 / 12 * np.arange(horizon(case)))
    assert found.fresh[0] @ discount == pytest.approx(2.0, rel=1e-13)
    np.testing.assert_allclose(found.fresh[3, 3:], found.fresh[0, :-3])
    np.testing.assert_allclose(found.payroll, 10.0)
    assert projected(replace(case, lee_carter=lee_carter())).streams is None
