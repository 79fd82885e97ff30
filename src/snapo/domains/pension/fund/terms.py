"""The numbers of a plan's rules, from the inputs of a case."""

from typing import Any, NamedTuple

from jaxtyping import Array

from ..people.cash_flows import reserved
from ..records.case import PensionCase
from ..records.inputs import use


class PlanTerms(NamedTuple):
    """The numbers of the rules, all scalars.

    Indexation: `cap`, `floor` per year, `lower`, `upper`, `required` funding ratios.
    Contribution: `rate` and limits `c_floor`, `c_cap` as shares of salaries, `loading`,
    `spread_factor` per year, `target` ratio, `recovery_years`, `sponsor` money per year.
    Liability: `reserved`, the amount set aside per value of a payment.
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
    reserved: Array


def plan_terms(case: PensionCase, inputs: dict[str, Any]) -> PlanTerms:
    """The numbers of a case's rules, from its inputs; zeros where a rule does not need one."""
    indexed, paid = case.plan.indexation, case.plan.contribution
    values = (
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
    return PlanTerms(*(use(inputs, item) for item in values), reserved=reserved(case, inputs))
