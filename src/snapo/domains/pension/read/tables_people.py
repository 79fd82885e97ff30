"""The tables of a case about people and rules, each key with its meaning; see `tables`."""

from collections.abc import Callable, Iterable
from typing import Annotated, Literal

from pydantic import Field

from snapo.case.meaning import Only, Tables
from snapo.case.table import CaseTable

from ..fund.contributions import CONTRIBUTIONS
from ..fund.increases import INCREASES
from .tables import (
    ABOVE,
    COHORTS,
    MINIMUM,
    PROMISED,
    RATE,
    SHARE,
    Name,
    NotNegative,
    Positive,
    Share,
    YearlyRate,
    csv,
    one_of,
)

BY_SALARY = ("rate", "floor", "cap")  # numbers of a contribution that are shares of salaries


def _kind(name: str) -> Callable[[Tables], str]:
    """The word for the kind of a table of a case."""
    return lambda tables: f'"{tables[name].kind}"'


def _either(kinds: Iterable[str]) -> str:
    by_name = " or ".join(f'"{kind}"' for kind in kinds)
    return f"with kind {by_name}"


def _increase(key: str) -> Only:
    """A number that some rules of increases take."""
    return Only(
        lambda tables: key in INCREASES[tables["plan.indexation"].kind].takes,
        _either(kind for kind, rule in INCREASES.items() if key in rule.takes),
        _kind("plan.indexation"),
    )


def _contribution(key: str) -> Only:
    """A number that some rules of contributions take."""
    return Only(
        lambda tables: key in CONTRIBUTIONS[tables["plan.contribution"].kind].takes,
        _either(kind for kind, rule in CONTRIBUTIONS.items() if key in rule.takes),
        _kind("plan.contribution"),
    )


def _of_mortality(kind: str) -> Only:
    return Only(
        lambda tables: tables["mortality"].kind == kind, _either([kind]), _kind("mortality")
    )


def _by_cost(tables: Tables) -> bool:
    """Whether contributions begin with the normal cost."""
    return CONTRIBUTIONS[tables["plan.contribution"].kind].by_cost


def _on_salaries(tables: Tables) -> bool:
    """Whether contributions are shares of salaries."""
    return any(getattr(tables["plan.contribution"], key) is not None for key in BY_SALARY)


def _increasing(tables: Tables) -> bool:
    rule = tables["plan.indexation"]
    apart = "plan.revaluation" in tables
    return rule.kind != "none" or rule.cut_years > 0 or apart or "pots" in tables


def _averaging(tables: Tables) -> bool:
    rule = tables["plan.indexation"]
    return "lower_ratio" in INCREASES[rule.kind].takes or rule.cut_years > 0


FLOWS = Only(lambda tables: tables["members"].cash_flows is not None, "with cash_flows")
SALARIES = Only(_on_salaries, "where contributions or their limits are shares of salaries")
ACCRUING = Only(lambda tables: tables["plan"].accruing, "where the plan is accruing")
ACCRUED = Only(lambda tables: tables["plan"].accrual_rate > 0, "with an accrual_rate above 0")
OPEN = Only(lambda tables: tables["plan"].open, "in an open plan")
SPOUSES = Only(lambda tables: tables["plan"].spouse_share > 0, "with a spouse_share above 0")
INCREASING = Only(_increasing, "where something happens once a year: increases, cuts or pots")
AVERAGED = Only(_averaging, 'with kind "conditional" or with cuts', _kind("plan.indexation"))
CUTS = Only(
    lambda tables: tables["plan.indexation"].cut_years > 0,
    "with cut_years above 0",
    _kind("plan.indexation"),
)
FIXED = Only(
    lambda tables: tables["plan.indexation"].kind in ("none", "fixed"),
    'where pensions in payment have increases of kind "fixed" or "none": others are of all rights'
    " alike",
    _kind("plan.indexation"),
)
BY_COST = Only(
    _by_cost,
    _either(kind for kind, rule in CONTRIBUTIONS.items() if rule.by_cost),
    _kind("plan.contribution"),
)
VALUED = Only(
    lambda tables: tables["plan.contribution"].normal_cost == "valuation",
    'with normal_cost "valuation"',
)
RATED = Only(
    lambda tables: (
        "rate" in CONTRIBUTIONS[tables["plan.contribution"].kind].takes
        or (_by_cost(tables) and tables["plan.contribution"].normal_cost == "rate")
    ),
    'with kind "fixed" or normal_cost "rate"',
    _kind("plan.contribution"),
)
PAID = Only(
    lambda tables: tables["plan.contribution"].kind != "none",
    'with another kind than "none"',
    _kind("plan.contribution"),
)
ADDED = Only(
    lambda tables: tables["liability"].basis != "risk-free",
    'with basis "spread" or "fixed"',
    lambda tables: f'"{tables["liability"].basis}"',
)
COMPARED = Only(
    lambda tables: any(tables["reconcile"].model_fields_set & {"liability", "duration"}),
    "beside a liability or a duration",
)


FormulaTable = Annotated[list[float], Field(min_length=2, max_length=3)]


class MembersTable(CaseTable):
    """`[members]`: cohorts, or the actuary's cash flows."""

    file: Name | None = csv(
        "name,status,sex,age,number,pension and, where they apply, salary,service,mortality", None
    )
    cash_flows: Name | None = csv("year (or month),amount", None)
    normal_cost: Annotated[NotNegative, FLOWS, ACCRUING] = Field(
        0.0, description="money per year, at least 0"
    )
    salary: Annotated[NotNegative, FLOWS, SALARIES] = Field(
        0.0, description="money per year, at least 0"
    )


class MortalityTable(CaseTable):
    """`[mortality]`: death probabilities or a formula, with improvement and multipliers."""

    kind: Literal["table", "gompertz-makeham"] = one_of("table", "gompertz-makeham")
    file: Annotated[Name | None, _of_mortality("table")] = csv("sex,age,q", None)
    male: Annotated[FormulaTable | None, _of_mortality("gompertz-makeham")] = Field(
        None, description="[alpha, beta] or [alpha, beta, makeham]"
    )
    female: Annotated[FormulaTable | None, _of_mortality("gompertz-makeham")] = Field(
        None, description="[alpha, beta] or [alpha, beta, makeham]"
    )
    year: Annotated[int, Field(ge=1900, le=2200)] | None = Field(
        None, description="the calendar year of these probabilities, from 1900 to 2200"
    )
    improvement: YearlyRate | Name = Field(
        0.0, description="a number between -1 and 1, or a CSV file with columns sex,age,value"
    )
    multiplier: Positive | Name = Field(
        1.0, description="a number above 0, or a CSV file with columns sex,age,value"
    )


class LeeCarterTable(CaseTable):
    """`[lee_carter]`: the stochastic factor of mortality."""

    volatility: NotNegative = Field(description=MINIMUM)
    file: Name = csv("sex,age,loading")


class PlanTable(CaseTable):
    """`[plan]`: benefits, and the two tables below it."""

    timing: Literal["advance", "arrears"] = one_of("advance", "arrears", default="arrears")
    age_basis: Annotated[Literal["nearest", "last", "exact"], COHORTS] = one_of(
        "nearest", "last", "exact", default="nearest"
    )
    fractional_ages: Annotated[Literal["constant-force", "uniform"], COHORTS] = one_of(
        "constant-force", "uniform", default="constant-force"
    )
    retirement_age: Annotated[float, Field(ge=40, le=90), COHORTS] = Field(
        67.0, description="an age from 40 to 90"
    )
    accruing: Annotated[bool, PROMISED] = Field(True, description="true or false")
    open: Annotated[bool, COHORTS] = Field(False, description="true or false")
    entry_age: Annotated[float, Field(ge=15, le=90), COHORTS, OPEN, ACCRUING] = Field(
        25.0, description="an age from 15 to 90"
    )
    max_service: Annotated[Positive, COHORTS, PROMISED, ACCRUING, ACCRUED] = Field(
        60.0, description="a number of years above 0"
    )
    accrual_rate: Annotated[Share, COHORTS, PROMISED, ACCRUING] = Field(0.0, description=SHARE)
    offset: Annotated[NotNegative, COHORTS, PROMISED, ACCRUING, ACCRUED] = Field(
        0.0, description="money per year, at least 0"
    )
    spouse_share: Annotated[Share, COHORTS] = Field(0.0, description=SHARE)
    married_share: Annotated[Share, COHORTS, SPOUSES] = Field(1.0, description=SHARE)
    spouse_age_gap: Annotated[int, Field(ge=-20, le=20), COHORTS, SPOUSES] = Field(
        3, description="a whole number from -20 to 20"
    )
    expenses: NotNegative = Field(0.0, description="money per year, at least 0")
    indexation: dict = Field({}, description="the table [plan.indexation]")
    revaluation: Annotated[dict | None, COHORTS, PROMISED, FIXED] = Field(
        None, description="the table [plan.revaluation]"
    )
    contribution: dict = Field({}, description="the table [plan.contribution]")


class IndexationTable(CaseTable):
    """`[plan.indexation]`: increases of pensions in payment, and of other rights alike where there
    is no `[plan.revaluation]`."""

    kind: Literal["none", "fixed", "full", "capped", "conditional"] = one_of(
        "none", "fixed", "full", "capped", "conditional", default="none"
    )
    rate: Annotated[YearlyRate | None, _increase("rate")] = Field(None, description=RATE)
    month: Annotated[int, Field(ge=1, le=12), INCREASING] = Field(1, description="a month, 1 to 12")
    averaging: Annotated[int, Field(ge=1, le=12), AVERAGED] = Field(
        12, description="a whole number of months, 1 to 12"
    )
    cap: Annotated[YearlyRate, _increase("cap")] = Field(0.5, description=RATE)
    floor: Annotated[YearlyRate, _increase("floor")] = Field(-0.5, description=RATE)
    lower_ratio: Annotated[NotNegative, _increase("lower_ratio")] = Field(1.1, description=MINIMUM)
    upper_ratio: Annotated[NotNegative, _increase("upper_ratio")] = Field(1.3, description=MINIMUM)
    required_ratio: Annotated[NotNegative, CUTS] = Field(1.0, description=MINIMUM)
    cut_years: Annotated[int, Field(ge=0, le=50), PROMISED] = Field(
        0, description="a whole number from 0 to 50"
    )


class RevaluationTable(CaseTable):
    """`[plan.revaluation]`: fixed increases of rights before payment, apart from payment."""

    deferred: YearlyRate = Field(0.0, description=f"of deferred members' rights, {RATE}")
    active: YearlyRate = Field(0.0, description=f"of rights in service, {RATE}")


class ContributionTable(CaseTable):
    """`[plan.contribution]`"""

    kind: Literal["none", "fixed", "normal-cost", "spread", "target"] = one_of(
        "none", "fixed", "normal-cost", "spread", "target", default="none"
    )
    normal_cost: Annotated[Literal["valuation", "rate"], BY_COST] = one_of(
        "valuation", "rate", default="valuation"
    )
    rate: Annotated[NotNegative | None, RATED] = Field(
        None, description=f"a share of salaries, {MINIMUM}"
    )
    loading: Annotated[float, Field(ge=-1), BY_COST, VALUED] = Field(
        0.0, description="a number of at least -1"
    )
    spread_factor: Annotated[NotNegative | None, _contribution("spread_factor")] = Field(
        None, description=f"per year, {MINIMUM}"
    )
    target_ratio: Annotated[Positive, _contribution("target_ratio")] = Field(1.0, description=ABOVE)
    recovery: Annotated[Literal["rolling", "level"], _contribution("recovery")] = one_of(
        "rolling", "level", default="rolling"
    )
    recovery_years: Annotated[Positive, _contribution("recovery_years")] = Field(
        10.0, description=ABOVE
    )
    floor: Annotated[float | None, PAID] = Field(None, description="a share of salaries")
    cap: Annotated[float | None, PAID] = Field(None, description="a share of salaries")
    sponsor_limit: Annotated[NotNegative | None, PAID] = Field(
        None, description="money per year, at least 0"
    )
    schedule: Name | None = csv("date,amount (or year,amount)", None)


class LiabilityTable(CaseTable):
    """`[liability]`"""

    basis: Literal["risk-free", "spread", "fixed"] = one_of(
        "risk-free", "spread", "fixed", default="risk-free"
    )
    rate: Annotated[YearlyRate | None, ADDED] = Field(None, description=RATE)
    expense_loading: Annotated[Share, PROMISED] = Field(
        0.0, description=f"a share of the value of the payments, {SHARE}"
    )
    future_indexation: Literal["none", "full", "capped"] = one_of(
        "none", "full", "capped", default="none"
    )


class ReconcileTable(CaseTable):
    """`[reconcile]`: the actuary's own figures."""

    liability: Positive | None = Field(None, description=ABOVE)
    duration: Positive | None = Field(None, description=ABOVE)
    tolerance: Annotated[float, Field(gt=0, lt=1), COMPARED] = Field(
        0.001, description="a number above 0 and below 1"
    )
