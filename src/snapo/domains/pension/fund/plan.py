"""Contribution and indexation rules of a plan, on one path."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from snapo.problem.smooth import Constraints

from ..records.case import PensionCase
from ..records.inputs import use
from ..records.plan import Plan

RATIO, GROWTH = 0.1, 0.01  # scales of corners in funding ratios and in yearly price growth


class PlanTerms(NamedTuple):
    """The numbers of the rules, all scalars.

    Indexation: `cap`, `floor` per year, `lower`, `upper`, `required` funding ratios.
    Contribution: `rate` and limits `c_floor`, `c_cap` as shares of salaries, `loading`,
    `spread_factor` per year, `target` ratio, `recovery_years`, `sponsor` money per year.
    """

    cap: Array
    floor: Array
    lower: Array
    upper: Array
    required: Array
    rate: Array
    loading: Array
    spread_factor: Array
    target: Array
    recovery_years: Array
    c_floor: Array
    c_cap: Array
    sponsor: Array


def plan_terms(case: PensionCase, inputs: dict[str, Any]) -> PlanTerms:
    """The numbers of a case's rules, from its inputs; zeros where a rule does not need one."""
    indexed, paid = case.plan.indexation, case.plan.contribution
    given = (
        indexed.cap,
        indexed.floor,
        indexed.lower_ratio,
        indexed.upper_ratio,
        indexed.required_ratio,
        paid.rate,
        paid.loading,
        paid.spread_factor,
        paid.target_ratio,
        paid.recovery_years,
        paid.floor,
        paid.cap,
        paid.sponsor_limit,
    )
    return PlanTerms(*(use(inputs, each) for each in given))


def contribution(
    plan: Plan,
    terms: PlanTerms,
    *,
    assets: ArrayLike,
    liability: ArrayLike,
    normal_cost: ArrayLike,
    payroll: ArrayLike,
    wage: ArrayLike,
    step: float,
    smooth: Constraints,
) -> Array:
    """The contribution of this step, money.

    **Arguments:**

    - `normal_cost`: value of the step's accrual; `payroll`: salaries of the step at wages of time
      0, `wage` over that of time 0; `step`: its length in years.
    """
    rule, salaries = plan.contribution, jnp.asarray(payroll * jnp.asarray(wage))
    if rule.kind == "none":
        return jnp.zeros_like(salaries)
    by_rate = rule.kind == "fixed" or rule.normal_cost == "rate"
    regular = terms.rate * salaries if by_rate else (1 + terms.loading) * normal_cost
    gap = liability - jnp.asarray(assets)
    if rule.kind == "spread":
        regular = regular + step * terms.spread_factor * gap
    elif rule.kind == "target":
        missing = terms.target * liability - assets
        missing = smooth.positive_part(missing, liability)
        regular = regular + step * missing / terms.recovery_years
    if rule.has_floor:
        regular = smooth.maximum(regular, terms.c_floor * salaries, salaries)
    if rule.has_cap:
        regular = smooth.minimum(regular, terms.c_cap * salaries, salaries)
    if rule.has_sponsor_limit:
        limit = terms.sponsor * step * wage
        regular = smooth.minimum(regular, limit, limit)
    return regular


def indexation(
    plan: Plan,
    terms: PlanTerms,
    *,
    ratio: ArrayLike,
    price_growth: ArrayLike,
    smooth: Constraints,
) -> tuple[Array, Array]:
    """(granted, cut) of the date: pensions are multiplied by 1 + granted - cut.

    `granted` may be negative under deflation; `cut` is at least 0.

    **Arguments:**

    - `ratio`: the policy funding ratio; `price_growth`: since the last date, I / I_last - 1.
    """
    rule, ratio = plan.indexation, jnp.asarray(ratio)
    granted = jnp.zeros_like(ratio)
    if rule.kind == "full":
        granted = jnp.asarray(price_growth)
    elif rule.kind != "none":
        granted = smooth.clip(price_growth, terms.floor, terms.cap, GROWTH)
    if rule.kind == "conditional":
        # Equal ratios make the ramp a jump; a width of a millionth keeps it finite.
        width = jnp.maximum(terms.upper - terms.lower, 1e-6)
        granted = granted * smooth.clip((ratio - terms.lower) / width, 0.0, 1.0, RATIO)
    cut = jnp.zeros_like(ratio)
    if rule.cut_years > 0:
        cut = smooth.positive_part(1 - ratio / terms.required, RATIO) / rule.cut_years
    return granted, cut


def indexation_flags(case: PensionCase) -> tuple[np.ndarray, np.ndarray]:
    """(due, averaging), each [T], the same for all paths.

    `due`: 1 in the step that ends on the first of the calendar month of indexation, with yearly
    steps in every one. `averaging`: weights of the funding ratios at the start of the last
    `averaging` steps before a date (fewer before the first one); they add up to 1 per date.
    """
    rule = case.plan.indexation
    if round(1 / case.step) == 1:
        return np.ones(case.steps), np.ones(case.steps)
    ends = (case.start_month + np.arange(case.steps)) % 12 + 1
    due = ends == rule.month
    averaging = np.zeros(case.steps)
    for last in np.flatnonzero(due):
        window = slice(max(last + 1 - rule.averaging, 0), last + 1)
        averaging[window] = 1 / (window.stop - window.start)
    return due.astype(float), averaging
