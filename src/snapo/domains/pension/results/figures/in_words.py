"""The benefits of a case and their valuation, in a sentence each."""

import numpy as np

from ...people.longer_life import AT_AGE, life_expectancy
from ...records.case import PensionCase
from ...records.inputs import input_values
from ...records.people import FEMALE, MALE
from ...records.plan import Indexation, PensionPlan

MONTHS = (
    "January", "February", "March", "April", "May", "June",
    "July", "August", "September", "October", "November", "December",
)  # fmt: skip
FULL = "the growth of prices"


def in_words(case: PensionCase) -> list[str]:
    """Accrual, increases by status, mortality and the basis of valuation."""
    return [
        f"accrual: {_accrual(case)}",
        f"increases: {_increases(case)}",
        *([] if case.mortality is None else [f"mortality: {_mortality(case)}"]),
        f"valuation: {_valuation(case)}",
    ]


def _accrual(case: PensionCase) -> str:
    plan = case.plan
    if case.pots is not None:
        return "none, contributions go into personal pots"
    if not plan.accruing:
        return "none, the plan is frozen"
    if case.members is None:
        cost = case.cash_flows is not None and case.cash_flows.normal_cost.used() > 0
        return (
            "in proportion to the cash flows, with the normal cost of the case" if cost else "none"
        )
    if not plan.accrual_rate.values.size:
        return "none, the plan has no accrual_rate"
    offset = float(plan.offset.used()) if plan.offset.values.size else 0.0
    base = f"(salary minus {offset:,.0f})" if offset else "salary"
    return (
        f"career average, {_percent(plan.accrual_rate)} of {base} for a year of service;"
        f" {_in_service(plan)}"
    )


def _in_service(plan: PensionPlan) -> str:
    apart = plan.revaluation
    if apart is None:
        none = plan.indexation.kind == "none"
        return "not revalued in service" if none else "revalued in service as pensions in payment"
    rate = float(apart.active.used())
    return f"revalued in service by {rate:.2%} a year" if rate else "not revalued in service"


def _increases(case: PensionCase) -> str:
    rule, apart = case.plan.indexation, case.plan.revaluation
    if case.pots is not None:
        return "pensions follow the pots"
    values = _rule(rule)
    if case.members is None:
        text = f"{values}, for all payments"
    elif apart is None:
        every = "pensions in payment, deferred rights and rights in service"
        text = values if rule.kind == "none" else f"{values}, the same for {every}"
    else:
        text = (
            f"in payment {values}, deferred rights {_percent(apart.deferred)}, rights in service"
            f" {_percent(apart.active)}"
        )
    yearly = rule.kind != "none" or apart is not None
    return f"{text}; every {MONTHS[rule.month - 1]}" if yearly and case.step < 1 else text


def _rule(rule: Indexation) -> str:
    def between() -> str:
        return f"{FULL} between {_percent(rule.floor)} and {_percent(rule.cap)}"

    if rule.kind == "fixed":
        assert rule.rate is not None
        return f"{_percent(rule.rate)} a year"
    if rule.kind == "conditional":
        low, high = float(rule.lower_ratio.used()), float(rule.upper_ratio.used())
        return (
            f"{between()}, from nothing at a policy ratio of {low:.0%} to the full increase "
            f"at {high:.0%}"
        )
    return {"none": "none", "full": FULL}.get(rule.kind) or between()


def _mortality(case: PensionCase) -> str:
    law = case.mortality
    assert law is not None
    last = law.first_age + law.ages - 1
    if law.kind == "table":
        end = law.first_age + law.table.index.shape[1] - 1
        text = f"a table of the ages {law.first_age} to {end}"
        text += f", extrapolated to {last}" if end < last else ""
    else:
        text = "a Gompertz-Makeham formula"
    if law.improvement.used().any():
        since = f"{law.since:.3g} years" if law.since else "none"
        text += f", improvement up to the valuation date: {since}"
    else:
        text += ", without improvement"
    inputs = input_values(case)
    men, women = (life_expectancy(case, inputs, sex, AT_AGE) for sex in (MALE, FEMALE))
    return f"{text}; life expectancy at {AT_AGE}: men {men:.1f} years, women {women:.1f}"


def _valuation(case: PensionCase) -> str:
    basis = case.liability
    if basis.basis == "fixed":
        text = f"at {_both(case)}"
    else:
        text = "on the curve"
        text += f" plus {_both(case)}" if basis.basis == "spread" else ""
    if basis.loading is not None:
        text += f", with {_percent(basis.loading)} for expenses"
    elif case.plan.expenses.values.any() and case.pots is None:
        text += ", with no reserve for expenses"
    return text


def _both(case: PensionCase) -> str:
    """The rate of the basis in both conventions; a spread in that of the case."""
    rate, annual = float(case.liability.rate.used()), case.liability.annual
    if case.liability.basis == "spread":
        return f"{rate:.2%} ({'annual' if annual else 'continuous'})"
    other = np.log1p(rate) if annual else np.expm1(rate)
    first, second = (rate, other) if annual else (other, rate)
    return f"{first:.2%} annual, {second:.2%} continuous"


def _percent(values) -> str:
    return f"{float(values.used()):.2%}"
