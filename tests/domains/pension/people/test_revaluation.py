"""Increases in payment and before it, apart by status, against sums written out."""

import numpy as np
import pytest
from tests.domains.pension.people_cases import (
    given,
    indexing,
    members,
    mortality,
    nothing,
    people_case,
    plan,
)

from snapo.domains.pension.fund.schedule import basis_log_bond
from snapo.domains.pension.people.cash_flows import horizon, project
from snapo.domains.pension.people.liability import people
from snapo.domains.pension.people.mortality import log_survival
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.people import ACTIVE, DEFERRED, FEMALE, MALE, PENSIONER
from snapo.domains.pension.records.plan import Liability, Revaluation
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy

IN_PAYMENT, DEFERMENT, SERVICE = 0.03, 0.025, 0.01
STEPS = 4


def apart(deferred=DEFERMENT, active=SERVICE):
    return Revaluation(
        deferred=given("revaluation_deferred", deferred), active=given("revaluation_active", active)
    )


def fund(
    status, age, spouse=0.0, revaluation=None, step=1.0, timing="advance", exact=False, **changes
):
    """One member, pension 1 a year from 65, at 8 % a year."""
    one = members(
        names=("one",),
        status=np.array([status]),
        sex=np.array([MALE]),
        age=np.array([float(age)]),
        number=given("members", [1.0]),
        pension=given("accrued_pension", [1.0]),
        salary=given("salary", [40.0]) if status == ACTIVE else nothing("salary", (1,)),
        service=np.zeros(1),
    )
    terms = plan(
        timing=timing,
        age_basis="exact" if exact else "nearest",
        retirement_age=65.0,
        spouse_share=given("plan_spouse_share", spouse) if spouse else nothing("spouse"),
        indexation=indexing("fixed", rate=given("indexation_rate", IN_PAYMENT), cut_years=0),
        revaluation=revaluation,
    )
    basis = Liability("fixed", given("liability_rate", np.log(1.08)), "none")
    return people_case(STEPS, step=step, members=one, plan=terms, liability=basis, **changes)


@with_numpy
def projected(case):
    inputs = plain(pension_inputs(case))
    log_bond = basis_log_bond(case, inputs)
    found = project(case, inputs, log_bond)
    return found.accrued, found.fresh, np.exp(log_bond)


@with_numpy
def alive(case, sex, age, count):
    inputs = plain(pension_inputs(case))
    return np.exp(log_survival(case, inputs, np.array([sex]), np.array([age]), count)[0])


@pytest.mark.prove
def test_a_deferred_member_s_pension_grows_from_its_first_payment_on():
    """Twenty years of waiting add nothing to it where increases are in payment only."""
    certain = mortality(
        multiplier=given("mortality_multiplier", [1e-12], np.zeros((2, 91), int)),
        table=np.minimum(mortality().table.used(), 0.5),
    )
    case = fund(DEFERRED, 45.0, revaluation=apart(0.0, 0.0), mortality=certain)
    flow, _, discount = projected(case)
    years = np.arange(20, len(flow) - STEPS)
    value = float(np.sum(1.03 ** (years - 20) * 1.08**-years))
    assert float(flow @ discount[: len(flow)]) == pytest.approx(value, rel=1e-9)
    alike = projected(fund(DEFERRED, 45.0, mortality=certain))[0]
    assert float(alike @ discount[: len(flow)]) == pytest.approx(1.03**20 * value, rel=1e-9)


@pytest.mark.parametrize("timing", ["advance", "arrears"])
@pytest.mark.parametrize(
    ("status", "rate", "age"),
    [(DEFERRED, DEFERMENT, 60), (ACTIVE, SERVICE, 60), (PENSIONER, IN_PAYMENT, 70)],
)
def test_rights_grow_by_the_rate_of_their_status_until_they_are_paid(timing, status, rate, age):
    case = fund(status, age, revaluation=apart(), timing=timing)
    flow, late = projected(case)[0], int(timing == "arrears")
    life, waits = alive(case, MALE, float(age), 40), max(0, 65 - age)
    for s in range(30):
        grown = (1 + rate) ** min(s, waits) * (1 + IN_PAYMENT) ** max(s - waits, 0)
        expected = life[s + late] * grown * (s >= waits)
        assert flow[s] == pytest.approx(expected, rel=1e-12, abs=0), s


def test_a_spouse_s_pension_grows_in_payment_from_the_member_s_death_on():
    """Summed over the years of death, in deferment or after it; and of what a later step earns."""
    case = fund(ACTIVE, 58.0, spouse=0.7, revaluation=apart())
    flow, fresh, _ = projected(case)
    count = horizon(case)
    own, other = alive(case, MALE, 58.0, count), alive(case, FEMALE, 55.0, count)
    right = [1.01 ** min(s, 7) * 1.03 ** max(s - 7, 0) for s in range(50)]

    def paid(s, since):
        """Per unit of a right that is there from step `since` on."""
        total = own[s] * right[s] * (s >= 7)
        for u in range(since + 1, s + 1):
            dies = own[u - 1] - own[u]
            total += 0.7 * 0.65 * other[s] * dies * right[u] * 1.03 ** (s - u)
        return total / right[since]

    for s in (0, 3, 7, 8, 30):
        assert flow[s] == pytest.approx(paid(s, 0), rel=1e-11), s
    for t, s in ((1, 2), (2, 8), (3, 30)):
        earned = 0.0175 * (40 - 15)
        assert fresh[t, s] == pytest.approx(earned * paid(s, t), rel=1e-11), (t, s)


@pytest.mark.prove
@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_a_pension_that_begins_within_a_step_pays_the_rest_of_it(timing):
    """Monthly steps and exact ages: half a month of a pension that begins in the middle of one."""
    age = 64 + 11.5 / 12
    late = int(timing == "arrears")
    case = fund(ACTIVE, age, step=1 / 12, timing=timing, exact=True)
    flow, fresh, _ = projected(case)
    life = alive(case, MALE, age, 12)
    for s, share in ((0, 0.5), (1, 1.0), (2, 1.0)):
        assert flow[s] == pytest.approx(share / 12 * life[s + late], rel=1e-12)
    inputs = plain(pension_inputs(case))
    earned = with_numpy(project)(case, inputs, np.zeros(horizon(case) + 1))
    # Half a month of work: of salary, and of accrual.
    assert np.asarray(earned.payroll)[:2].tolist() == pytest.approx([0.5 * 40 / 12, 0.0])
    right = 0.5 * 0.0175 / 12 * (40 - 15)
    assert fresh[0, 1] == pytest.approx(right / 12 * life[1 + late], rel=1e-12)
    assert not fresh[1:].any()


@pytest.mark.prove
@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_a_liability_with_all_of_it_rolls_forward_along_the_forward_curve(timing):
    """Increases apart, a loading and pensions that begin within steps: what is left is worth the
    forward value of today's and of what is earned, less what was paid and set free."""
    rate, loading = given("liability_rate", 0.02), given("expense_loading", 0.04)
    case = people_case(
        30,
        plan=plan(
            timing=timing,
            age_basis="exact",
            retirement_age=62.9,
            indexation=indexing("fixed", rate=given("indexation_rate", 0.03), cut_years=0),
            revaluation=apart(),
        ),
        liability=Liability("spread", rate, "none", annual=True, loading=loading),
    )
    inputs = plain(pension_inputs(case))
    log_bond = with_numpy(basis_log_bond)(case, inputs)
    found = with_numpy(people)(case, inputs, log_bond)
    growth = np.exp(log_bond[:30] - log_bond[1:31])
    value = (found.accrued + found.fresh).sum(1)
    new = found.baseline[:30] * found.accrual[:30].sum(1)
    paid = 1.04 * (found.benefit + found.fresh_benefit)[:30]
    early, late = (paid, 0) if timing == "advance" else (0, paid)
    np.testing.assert_allclose(value[1:], (value[:30] + new - early) * growth - late, rtol=1e-11)
    assert new[8] > 0 and found.fresh_benefit[20] > 0
