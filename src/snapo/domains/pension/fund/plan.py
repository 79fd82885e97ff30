"""Contribution and indexation of a plan on one path: its rules, applied within their limits."""

import numpy as np

from snapo.problem.record.arrays import Array, ArrayLike
from snapo.problem.record.either import xp
from snapo.problem.smooth import Constraints

from ..people.fixed_increases import due as increases_due
from ..records.case import PensionModel
from ..records.plan import PensionPlan
from .contributions import CONTRIBUTIONS, ContributionDue
from .increases import INCREASES, RATIO
from .terms import PlanTerms


def contribution(
    plan: PensionPlan,
    terms: PlanTerms,
    *,
    assets: ArrayLike,
    liability: ArrayLike,
    normal_cost: ArrayLike,
    payroll: ArrayLike,
    wage: ArrayLike,
    step: float,
    smooth: Constraints,
    annuity: Array | None = None,
) -> Array:
    """The contribution of this step, in money.

    **Arguments:**

    - `normal_cost`: value of the step's accrual; `payroll`: salaries of the step at wages of time
      0; `wage`: wages relative to time 0; `step`: its length in years; `annuity`: the value of
      level payments (see `contributions`).
    """
    rule, salaries = plan.contribution, xp.asarray(payroll * xp.asarray(wage))
    by_rate = rule.normal_cost == "rate"
    normal = terms.rate * salaries if by_rate else (1 + terms.loading) * normal_cost
    money = (xp.asarray(assets), xp.asarray(liability), salaries, xp.asarray(normal))
    due = ContributionDue(*money, step, annuity)
    regular = CONTRIBUTIONS[rule.kind].amount(terms, due, smooth)
    if rule.has_floor:
        regular = smooth.maximum(regular, terms.c_floor * salaries, salaries)
    if rule.has_cap:
        regular = smooth.minimum(regular, terms.c_cap * salaries, salaries)
    if rule.has_sponsor_limit:
        limit = terms.sponsor * step * wage
        regular = smooth.minimum(regular, limit, limit)
    return regular


def indexation(
    plan: PensionPlan,
    terms: PlanTerms,
    *,
    ratio: ArrayLike,
    price_growth: ArrayLike,
    smooth: Constraints,
) -> tuple[Array, Array]:
    """The pair (granted, cut) on a date: pensions are multiplied by 1 + granted - cut.

    `granted` may be negative under deflation; `cut` is at least 0.

    **Arguments:**

    - `ratio`: the policy funding ratio; `price_growth`: the growth of prices since the last date,
      I / I_last - 1.
    """
    rule, ratio = plan.indexation, xp.asarray(ratio)
    granted = INCREASES[rule.kind].granted(terms, ratio, xp.asarray(price_growth), smooth)
    cut = xp.zeros_like(ratio)
    if rule.cut_years > 0:
        cut = smooth.positive_part(1 - ratio / terms.required, RATIO) / rule.cut_years
    return granted, cut


def indexation_flags(case: PensionModel) -> tuple[np.ndarray, np.ndarray]:
    """The flags (due, averaging), each [T], the same for all paths.

    `due`: 1 in the step that ends on the first of the calendar month of indexation; with yearly
    steps, 1 in every step. `averaging`: weights of the funding ratios at the start of the last
    `averaging` steps before a date (fewer before the first date); they add up to 1 for each date.
    """
    rule = case.plan.indexation
    if round(1 / case.step) == 1:
        return np.ones(case.steps), np.ones(case.steps)
    due = increases_due(case, case.steps)
    averaging = np.zeros(case.steps)
    for last in np.flatnonzero(due):
        window = slice(max(last + 1 - rule.averaging, 0), last + 1)
        averaging[window] = 1 / (window.stop - window.start)
    return due.astype(float), averaging
