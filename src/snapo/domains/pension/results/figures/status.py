"""Members and liability by status, and the fund's payments of today, in money per year."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import added, with_numpy, xp
from snapo.problem.smooth import Exact

from ...fund.plan import contribution, indexation
from ...fund.schedule import agreed, annuity, basis_log_bond
from ...fund.terms import plan_terms
from ...market.curve import log_bond
from ...people.cash_flows import horizon, project, reserved
from ...people.liability import paid_at, people
from ...records.case import PensionCase
from ...records.people import ACTIVE, DEFERRED, PENSIONER, SPOUSE

STATUSES = {
    ACTIVE: "active",
    DEFERRED: "deferred",
    PENSIONER: "pensioners",
    SPOUSE: "spouses",
}


class StatusGroup(NamedTuple):
    """The members of one status: their number; the pensions that they have earned and their
    salaries, in money per year; and the liability to them and their spouses, in money."""

    name: str
    members: float
    pensions: float
    payroll: float
    liability: float


class Pace(NamedTuple):
    """Payments of the first step, as money per year.

    - `accrual`: the value of the rights that are earned, on the basis of the liability.
    - `contribution`: the contribution by the rule and its limits, including the `agreed` payments
      in money.
    - `benefits`, `expenses`: the payments. `payroll`: salaries.
    - `increase`: the increase net of cuts, as a share, for a year in which prices grow at the
      one-year break-even; if increases are fixed, the fixed rate. `raised`: the increase of a
      year's benefits, in money; `liability_raised`: the increase of the liability, in money, 0 if
      the payments contain it.
    """

    accrual: float
    contribution: float
    benefits: float
    expenses: float
    payroll: float
    increase: float
    raised: float
    liability_raised: float


def groups(case: PensionCase, inputs: dict[str, Any]) -> list[StatusGroup]:
    """Every status that has members; none if the case has cash flows instead."""
    members = case.members
    if members is None:
        return []
    value = with_numpy(_by_cohort)(case, inputs)
    number, pension, salary = (
        entry.used() if entry.values.size else np.zeros(len(members.status))
        for entry in (members.number, members.pension, members.salary)
    )
    salary = np.where(members.status == ACTIVE, salary, 0.0)
    return [
        StatusGroup(
            name,
            float(number[rows].sum()),
            float(number[rows] @ pension[rows]),
            float(number[rows] @ salary[rows]),
            float(value[rows].sum()),
        )
        for status, name in STATUSES.items()
        if (rows := members.status == status).any()
    ]


def _by_cohort(case: PensionCase, inputs: dict[str, Any]):
    """[C] the liability of rights earned by now, to every cohort and its spouses."""
    members = case.members
    bond = basis_log_bond(case, inputs)
    streams = project(case, inputs, bond).streams
    assert streams is not None and members is not None
    within = np.arange(horizon(case) - case.steps)
    value = streams.held * (streams.unit[:, within] @ xp.exp(bond[paid_at(case, within)]))
    earned = added(xp.zeros(len(streams.lives.age)), streams.group, value)
    return reserved(case, inputs) * earned[: len(members.status)]


def pace(case: PensionCase, inputs: dict[str, Any], liability: float) -> Pace:
    """The payments of today; `liability` is that of the case."""
    numbers = with_numpy(_pace)(case, inputs, liability)
    return Pace(*map(float, numbers))


def _pace(case: PensionCase, inputs: dict[str, Any], liability: float) -> tuple[Array, ...]:
    """The numbers of `Pace`, in its order."""
    lives, terms = people(case, inputs, basis_log_bond(case, inputs)), plan_terms(case, inputs)
    assets = xp.asarray(float(case.assets.amount.used()))
    level, sums = annuity(case, inputs), agreed(case, inputs)
    accrual, payroll = xp.sum(lives.accrual[0]), lives.payroll[0]
    paid = contribution(
        case.plan,
        terms,
        assets=assets,
        liability=liability,
        normal_cost=accrual,
        payroll=payroll,
        wage=1.0,
        step=case.step,
        smooth=Exact(),
        annuity=None if level is None else level[0],
    )
    paid = paid if sums is None else paid + sums[0]
    growth = xp.expm1(-log_bond(case.inflation.break_even, inputs, np.ones(1))[0])
    ratio = assets / liability if liability else xp.inf
    granted, cut = indexation(case.plan, terms, ratio=ratio, price_growth=growth, smooth=Exact())
    fixed = case.plan.indexation.rate if case.plan.indexation.kind == "fixed" else None
    increase = granted - cut if fixed is None else xp.asarray(float(fixed.used()))
    benefits = lives.benefit[0] / case.step
    # Payments that follow prices in the valuation contain the increase, but no cut.
    risen = granted if case.liability.future_indexation == "none" else xp.zeros(())
    return (
        accrual / case.step,
        paid / case.step,
        benefits,
        lives.expenses[0] / case.step,
        payroll / case.step,
        increase,
        increase * benefits,
        (risen - cut) * liability,
    )
