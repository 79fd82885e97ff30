"""The tables of a case about people and rules, with the meaning of every key; see `tables`."""

from collections.abc import Callable, Iterable
from typing import Annotated, Literal

from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.meaning import Only, Tables
from snapo.case.quantity import ANY, FRACTION, NOT_NEGATIVE, POSITIVE, Range
from snapo.case.table import CaseTable, Nonempty, doc, subtable

from ..fund.contributions import CONTRIBUTIONS
from ..fund.increases import INCREASES
from ..quantities import (
    AMOUNT,
    BY_AGE,
    MONEY_YEARLY,
    RATE,
    SHARE,
    SQUARE_ROOT,
    TIME,
    YEARLY,
    YEARLY_RATE,
    plain,
)
from .tables import COHORTS, PROMISED, csv

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
SALARIES = Only(_on_salaries, "if contributions or their limits are shares of salaries")
ACCRUING = Only(lambda tables: tables["plan"].accruing, "if the plan is accruing")
ACCRUED = Only(
    lambda tables: tables["plan"].accrual_rate.used() > 0, "with an accrual_rate above 0"
)
OPEN = Only(lambda tables: tables["plan"].open, "in an open plan")
SPOUSES = Only(lambda tables: tables["plan"].spouse_share.used() > 0, "with a spouse_share above 0")
INCREASING = Only(_increasing, "if something happens once a year: increases, cuts or pots")
AVERAGED = Only(_averaging, 'with kind "conditional" or with cuts', _kind("plan.indexation"))
CUTS = Only(
    lambda tables: tables["plan.indexation"].cut_years > 0,
    "with cut_years above 0",
    _kind("plan.indexation"),
)
FIXED = Only(
    lambda tables: tables["plan.indexation"].kind in ("none", "fixed"),
    'if pensions in payment have increases of kind "fixed" or "none"; other kinds apply to'
    " all rights",
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
    'with a kind other than "none"',
    _kind("plan.contribution"),
)
ADDED = Only(
    lambda tables: tables["liability"].basis != "risk-free",
    'with basis "spread" or "fixed"',
    lambda tables: f'"{tables["liability"].basis}"',
)
COMPARED = Only(
    lambda tables: any(tables["reconcile"].model_fields_set & {"liability", "duration"}),
    "with a liability or a duration",
)


MEMBER_MONEY = AMOUNT.of("people", unit="money/year", range=MONEY_YEARLY)
PLAN_MONEY, PLAN_RATE = MEMBER_MONEY.of("plan"), RATE.of("plan")
PLAN_SHARE, RATIO = SHARE.of("plan"), SHARE.of("plan", range=NOT_NEGATIVE)

RULE = SHARE.of("plan", range=ANY)
OF_SALARIES = Range(noun="a share of salaries")
WHOLE, FORMULA = "a whole number", "[alpha, beta] or [alpha, beta, makeham]"
FormulaTable = Annotated[list[float], Field(min_length=2, max_length=3)]


class MembersTable(CaseTable):
    """`[members]`: cohorts, or the actuary's cash flows."""

    file: Nonempty | None = csv(
        "cohorts of members",
        "name,status,sex,age,number,pension and, where they apply, salary,service,mortality",
        None,
    )
    cash_flows: Nonempty | None = csv(
        "the actuary's expected payments, in money, instead of cohorts", "year,amount", None
    )
    normal_cost: Annotated[CaseInput, FLOWS, ACCRUING] = MEMBER_MONEY(
        "today's value of one year's accrual", 0.0, name="normal_cost"
    )
    salary: Annotated[CaseInput, FLOWS, SALARIES] = MEMBER_MONEY(
        "all salaries", 0.0, name="payroll"
    )


class MortalityTable(CaseTable):
    """`[mortality]`: death probabilities or a formula, with improvement and multipliers."""

    kind: Literal["table", "gompertz-makeham"] = doc("source of the death probabilities")
    file: Annotated[Nonempty | None, _of_mortality("table")] = csv(
        "death probabilities", "sex,age,q", None
    )
    male: Annotated[FormulaTable | None, _of_mortality("gompertz-makeham")] = doc(
        "formula of the death probabilities of men", None, FORMULA
    )
    female: Annotated[FormulaTable | None, _of_mortality("gompertz-makeham")] = doc(
        "formula of the death probabilities of women", None, FORMULA
    )
    year: int | None = plain(
        "year from which mortality improves",
        Range(1900, 2200, noun="the calendar year of the death probabilities,"),
        None,
    )
    improvement: CaseInput | Nonempty = RATE(
        "the yearly fall of death rates", 0.0, group="people", by=BY_AGE
    )
    multiplier: CaseInput | Nonempty = AMOUNT(
        "factor on death probabilities", 1.0, unit="1",
        range=POSITIVE, group="people", by=BY_AGE, name="mortality_multiplier",
    )  # fmt: skip


class LeeCarterTable(CaseTable):
    """`[lee_carter]`: the stochastic factor of mortality."""

    volatility: CaseInput = AMOUNT(
        "volatility of the mortality factor", unit=SQUARE_ROOT, group="volatility"
    )
    file: Nonempty = csv("loadings of the mortality factor", "sex,age,loading")


class PlanTable(CaseTable):
    """`[plan]`: benefits, and the two tables below it."""

    timing: Literal["advance", "arrears"] = doc(
        "whether pensions are paid at the start or the end of a step", "arrears"
    )
    age_basis: Annotated[Literal["nearest", "last", "exact"], COHORTS] = doc(
        "ages at the nearest birthday, at the last birthday, or exact", "nearest"
    )
    fractional_ages: Annotated[Literal["constant-force", "uniform"], COHORTS] = doc(
        "distribution of deaths between two birthdays", "constant-force"
    )
    retirement_age: Annotated[float, COHORTS] = plain(
        "age at which pensions begin, in years", Range(40.0, 90.0, noun="an age"), 67.0
    )
    accruing: Annotated[bool, PROMISED] = doc("whether members in service earn new rights", True)
    open: Annotated[bool, COHORTS] = doc("whether new members replace those who leave", False)
    entry_age: Annotated[float, COHORTS, OPEN, ACCRUING] = plain(
        "age of new members, in years", Range(15.0, 90.0, noun="an age"), 25.0
    )
    max_service: Annotated[float, COHORTS, PROMISED, ACCRUING, ACCRUED] = plain(
        "years of service after which no more rights are earned",
        Range(0.0, endpoints="()", noun="a number of years"),
        60.0,
    )
    accrual_rate: Annotated[CaseInput, COHORTS, PROMISED, ACCRUING] = PLAN_RATE(
        "the pension from a year of service, as a share of salary minus offset", 0.0, range=FRACTION
    )
    offset: Annotated[CaseInput, COHORTS, PROMISED, ACCRUING, ACCRUED] = PLAN_MONEY(
        "the part of a salary that earns no pension", 0.0
    )
    spouse_share: Annotated[CaseInput, COHORTS] = PLAN_SHARE(
        "the spouse's pension as a share of the member's", 0.0
    )
    married_share: Annotated[CaseInput, COHORTS, SPOUSES] = PLAN_SHARE(
        "the share of members with a spouse", 1.0
    )
    spouse_age_gap: Annotated[int, COHORTS, SPOUSES] = plain(
        "years by which wives are younger than husbands", Range(-20, 20, noun=WHOLE), 3
    )
    expenses: CaseInput = PLAN_MONEY("the yearly expenses of the scheme", 0.0)
    indexation: dict = subtable("yearly increases of pensions in payment", "plan.indexation", {})
    revaluation: Annotated[dict | None, COHORTS, PROMISED, FIXED] = subtable(
        "yearly increases of rights before payment", "plan.revaluation", None
    )
    contribution: dict = subtable("rule of contributions", "plan.contribution", {})


class IndexationTable(CaseTable):
    """`[plan.indexation]`: increases of pensions in payment; without `[plan.revaluation]`, the same
    increases of all other rights."""

    kind: Literal["none", "fixed", "full", "capped", "conditional"] = doc(
        "rule of the increases", "none"
    )
    rate: Annotated[CaseInput | None, _increase("rate")] = PLAN_RATE("fixed indexation", None)
    month: Annotated[int, INCREASING] = plain(
        "calendar month of increases and cuts, and of the end of a year of pots",
        Range(1, 12, noun="a month"),
        1,
    )
    averaging: Annotated[int, AVERAGED] = plain(
        "months whose mean is the policy funding ratio",
        Range(1, 12, noun="a whole number of months"),
        12,
    )
    cap: Annotated[CaseInput, _increase("cap")] = PLAN_RATE("largest rate of indexation", 0.5)
    floor: Annotated[CaseInput, _increase("floor")] = PLAN_RATE("smallest rate of indexation", -0.5)
    lower_ratio: Annotated[CaseInput, _increase("lower_ratio")] = RATIO(
        "funding ratio below which there is no indexation", 1.1
    )
    upper_ratio: Annotated[CaseInput, _increase("upper_ratio")] = RATIO(
        "funding ratio above which there is full indexation", 1.3
    )
    required_ratio: Annotated[CaseInput, CUTS] = RATIO(
        "funding ratio below which pensions are cut", 1.0
    )
    cut_years: Annotated[int, PROMISED] = plain(
        "years over which a cut is spread, 0 for no cuts", Range(0, 50, noun=WHOLE), 0
    )


class RevaluationTable(CaseTable):
    """`[plan.revaluation]`: fixed increases of rights before payment, which differ from those in
    payment."""

    deferred: CaseInput = PLAN_RATE(
        "yearly increase of deferred rights until payment",
        0.0,
        range=YEARLY_RATE._replace(noun="a rate for deferred members' rights"),
    )
    active: CaseInput = PLAN_RATE(
        "yearly increase of active members' rights",
        0.0,
        range=YEARLY_RATE._replace(noun="a rate for active members' rights"),
    )


class ContributionTable(CaseTable):
    """`[plan.contribution]`: the rule of contributions and its limits."""

    kind: Literal["none", "fixed", "normal-cost", "spread", "target"] = doc(
        "rule of the contributions", "none"
    )
    normal_cost: Annotated[Literal["valuation", "rate"], BY_COST] = doc(
        "normal cost: value of the accrual, or a share of salaries", "valuation"
    )
    rate: Annotated[CaseInput | None, RATED] = RULE(
        "contributions, or normal cost, as a share of salaries",
        None,
        range=OF_SALARIES._replace(low=0.0),
    )
    loading: Annotated[CaseInput, BY_COST, VALUED] = RULE(
        "loading on the normal cost, as a share of it", 0.0, range=Range(-1.0)
    )
    spread_factor: Annotated[CaseInput | None, _contribution("spread_factor")] = RULE(
        "contributions of a year, as a share of the deficit",
        None,
        unit=YEARLY,
        range=Range(0.0, noun="a number per year"),
    )
    target_ratio: Annotated[CaseInput, _contribution("target_ratio")] = RULE(
        "funding ratio that contributions aim at", 1.0, range=POSITIVE
    )
    recovery: Annotated[Literal["rolling", "level"], _contribution("recovery")] = doc(
        "recovery by an annuity to a fixed date, or by a rolling share of the gap", "rolling"
    )
    recovery_years: Annotated[CaseInput, _contribution("recovery_years")] = TIME(
        "time in which the gap to the target is closed", 10.0, group="plan"
    )
    floor: Annotated[CaseInput | None, PAID] = RULE(
        "smallest contributions, as a share of salaries", None, range=OF_SALARIES
    )
    cap: Annotated[CaseInput | None, PAID] = RULE(
        "largest contributions, as a share of salaries", None, range=OF_SALARIES
    )
    sponsor_limit: Annotated[CaseInput | None, PAID] = PLAN_MONEY(
        "largest contributions in money, which grow with wages", None
    )
    schedule: Annotated[Nonempty | None, PROMISED] = csv(
        "payments agreed in money, beyond the rule and its limits",
        "date,amount (or year,amount)",
        None,
    )


class LiabilityTable(CaseTable):
    """`[liability]`: the valuation of the payments."""

    basis: Literal["risk-free", "spread", "fixed"] = doc(
        "discount rate: the curve, the curve plus a rate, or a rate", "risk-free"
    )
    rate: Annotated[CaseInput | None, ADDED] = PLAN_RATE(
        "the rate that the valuation adds to the curve, or uses instead of the curve", None
    )
    expense_loading: Annotated[CaseInput, PROMISED] = PLAN_SHARE(
        "the reserve for expenses, as a share of the value of the payments", 0.0,
        range=FRACTION._replace(noun="a share of the value of the payments"),
    )  # fmt: skip
    future_indexation: Literal["none", "full", "capped"] = doc(
        "the future increases that are included in the value of payments", "none"
    )


class ReconcileTable(CaseTable):
    """`[reconcile]`: the actuary's figures."""

    liability: float | None = plain("the actuary's liability, in money", POSITIVE, None)
    duration: float | None = plain(
        "the actuary's duration of the liability, in years", POSITIVE, None
    )
    tolerance: Annotated[float, COMPARED] = plain(
        "largest relative difference from the actuary's figures", Range(0.0, 1.0, "()"), 0.001
    )
