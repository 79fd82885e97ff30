"""Reads `[plan]`, `[liability]` and `[reconcile]`: promises, contributions and their valuation.

A number that the rule of a case does not look at is no input: its `CaseInput` stays empty.
"""

import numpy as np

from snapo.case.csv import FileReference
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ..fund.contributions import CONTRIBUTIONS
from ..fund.increases import INCREASES
from ..records.case import Frontier, PensionCase
from ..records.plan import Contribution, Indexation, Liability, PensionPlan, Reconcile, Revaluation
from ..records.said import YEARLY, InputNumber, amount, rate, share, time
from .cash_plan import PlanClock, read_cash_plan
from .cells import WHOLE, TableReader, empty, single, years
from .tables import FrontierTable
from .tables_people import (
    ContributionTable,
    IndexationTable,
    LiabilityTable,
    PlanTable,
    ReconcileTable,
    RevaluationTable,
)

ACCRUAL = rate("the share of salary less offset that a year of service earns", "plan")
OFFSET, EXPENSES = "the part of a salary without a pension", "the yearly expenses of the scheme"
SPOUSE = share("the spouse's pension as a share of the member's", "plan")
MARRIED = share("the share of members with a spouse", "plan")
REVALUED = rate("the yearly increase of rights before payment", "plan")
LOADED = share("the reserve for expenses, as a share of the value of the payments", "plan")
INDEXED = rate("the rate, or a limit, of yearly indexation", "plan")
RATIO = share("a funding ratio in the rule of indexation", "plan")
RULE = share("a number of the rule of contributions", "plan")
VALUED = rate("the rate that is added to the curve, or takes its place, in valuation", "plan")
LIMITS = ("floor", "cap", "sponsor_limit")


def read_plan(
    section: TableContext,
    table: PlanTable,
    indexation: Indexation,
    revaluation: Revaluation | None,
    contribution: Contribution,
    money: str,
) -> PensionPlan:
    """Terms of the scheme; numbers that nothing was said about are no inputs."""

    def input(name: str, metadata: InputNumber) -> CaseInput:
        value = getattr(table, name)
        written = name in table.model_fields_set
        # A share of one that was left unsaid is a fact of the format, not a number of the owner.
        return (
            single(f"plan_{name}", value, metadata)
            if written or value
            else _nothing(f"plan_{name}")
        )

    yearly = f"{money}/year"
    married = input("married_share", MARRIED) if table.spouse_share else _nothing("married")

    return PensionPlan(
        timing=table.timing,
        retirement_age=table.retirement_age,
        accrual_rate=input("accrual_rate", ACCRUAL),
        offset=input("offset", amount(OFFSET, "plan", yearly)),
        spouse_share=input("spouse_share", SPOUSE),
        married_share=married,
        spouse_age_gap=table.spouse_age_gap,
        age_basis=table.age_basis,
        fractional_ages=table.fractional_ages,
        open=table.open,
        accruing=table.accruing,
        entry_age=table.entry_age,
        max_service=table.max_service,
        expenses=input("expenses", amount(EXPENSES, "plan", yearly)),
        indexation=indexation,
        contribution=contribution,
        revaluation=revaluation,
    )


def _nothing(name: str) -> CaseInput:
    return empty(name, ())


def read_indexation(section: TableContext, table: IndexationTable) -> Indexation:
    """Increases once a year; cap and floor only where the rule has them."""
    kind = table.kind
    used = INCREASES[kind].takes
    cuts = ["required_ratio"] if table.cut_years else []
    if kind == "fixed" and table.rate is None:
        raise section.error("rate", None, 'kind "fixed" needs this key')
    if table.floor > table.cap:
        raise section.error("floor", table.floor, f"allowed is at most cap, {table.cap:g}")
    if "lower_ratio" in used and table.lower_ratio >= table.upper_ratio:
        message = f"allowed is less than upper_ratio, {table.upper_ratio:g}"
        raise section.error("lower_ratio", table.lower_ratio, message)

    def input(name: str) -> CaseInput:
        available = name in used or name in cuts
        metadata = INDEXED if name in ("cap", "floor", "rate") else RATIO
        name, value = f"indexation_{name}", getattr(table, name)
        return single(name, value, metadata) if available else _nothing(name)

    return Indexation(
        kind=kind,
        month=table.month,
        averaging=table.averaging,
        cap=input("cap"),
        floor=input("floor"),
        lower_ratio=input("lower_ratio"),
        upper_ratio=input("upper_ratio"),
        required_ratio=input("required_ratio"),
        cut_years=table.cut_years,
        rate=input("rate") if kind == "fixed" else None,
    )


def read_revaluation(section: TableReader, table: RevaluationTable | None) -> Revaluation | None:
    """Rates of increase before payment; None where rights grow as pensions in payment do."""
    if table is None:
        return None

    def input(key: str) -> CaseInput:
        return section.input(
            table, key, single(f"revaluation_{key}", getattr(table, key), REVALUED)
        )

    return Revaluation(deferred=input("deferred"), active=input("active"))


def read_contribution(
    section: TableContext, table: ContributionTable, timer: PlanClock
) -> Contribution:
    """The rule of contributions with its limits, and payments agreed in money."""
    kind, rule, money = table.kind, CONTRIBUTIONS[table.kind], timer.grid.currency
    schedule = None
    if table.schedule is not None:
        schedule = read_cash_plan(FileReference(section, "schedule", table.schedule), timer)
    used = list(rule.takes)
    if rule.by_cost:
        used.append("rate" if table.normal_cost == "rate" else "loading")
    if kind != "none":
        used += [limit for limit in LIMITS if getattr(table, limit) is not None]
    for key in used:
        if getattr(table, key) is None:
            raise section.error(key, None, f'kind "{kind}" needs this key')
    if table.floor is not None and table.cap is not None and table.floor > table.cap:
        raise section.error("floor", table.floor, f"allowed is at most cap, {table.cap:g}")
    level = None
    if kind == "target" and table.recovery == "level":
        step = timer.grid.step
        level = round(table.recovery_years / step)
        if not level or abs(level * step - table.recovery_years) > WHOLE:
            message = f"level payments end after whole steps of {years(step)}"
            raise section.error("recovery_years", table.recovery_years, message)
    metadata = {
        "spread_factor": share(RULE.meaning, "plan", YEARLY),
        "recovery_years": time(RULE.meaning, "plan"),
        "sponsor_limit": amount(RULE.meaning, "plan", f"{money}/year"),
    }

    def input(name: str) -> CaseInput:
        value, full = getattr(table, name), f"contribution_{name}"
        # A loading of zero that nobody wrote is no number of the owner's.
        requested = name in used and (name != "loading" or name in table.model_fields_set)
        requested = requested and (
            name != "recovery_years" or level is None
        )  # a date has no gradient
        return single(full, value, metadata.get(name, RULE)) if requested else _nothing(full)

    return Contribution(
        kind=kind,
        normal_cost=table.normal_cost,
        rate=input("rate"),
        loading=input("loading"),
        spread_factor=input("spread_factor"),
        target_ratio=input("target_ratio"),
        recovery_years=input("recovery_years"),
        floor=input("floor"),
        cap=input("cap"),
        sponsor_limit=input("sponsor_limit"),
        has_floor="floor" in used,
        has_cap="cap" in used,
        has_sponsor_limit="sponsor_limit" in used,
        schedule=schedule,
        level_steps=level,
    )


def read_liability(section: TableContext, table: LiabilityTable, annual: bool) -> Liability:
    """How payments are valued; `annual`: the compounding of the case."""
    requested = table.basis != "risk-free"
    if requested and table.rate is None:
        raise section.error("rate", None, f'basis "{table.basis}" needs this key')
    name = "liability_rate"
    added = single(name, table.rate, VALUED) if table.rate is not None else _nothing(name)
    loading = None
    if table.expense_loading:
        loading = single("liability_expense_loading", table.expense_loading, LOADED)
    return Liability(table.basis, added, table.future_indexation, annual, loading)


def check_limited(case: PensionCase) -> None:
    """Options in limited increases can be valued where increases are limited and models hold.

    **Raises:** `CaseError` with the reason where they cannot.
    """
    if case.liability.future_indexation != "capped":
        return
    models = (case.rates.volatility, case.inflation.volatility, case.inflation.index_volatility)
    message = None
    if case.plan.indexation.kind != "capped":
        message = 'increases of plan.indexation are not limited: kind "capped" is needed'
    elif case.scenarios is not None:
        message = "ready-made scenarios hold no volatilities, which the options' value needs"
    elif any(np.ptp(model.used(), axis=0).any() for model in models):
        message = "options are valued at volatilities of rates and inflation that do not change"
    if message is not None:
        raise CaseError(str(case.file), "liability.future_indexation", "capped", message)


def read_frontier(
    section: TableContext, table: FrontierTable | None, plan: PensionPlan
) -> Frontier | None:
    """The sweep of contributions against the shortfall, where one is asked for."""
    if table is None:
        return None
    kind = plan.contribution.kind
    if not CONTRIBUTIONS[kind].responds:
        allowed = " and ".join(f'"{k}"' for k, rule in CONTRIBUTIONS.items() if rule.responds)
        message = (
            f'contributions of kind "{kind}" do not depend on decisions; '
            f"allowed are {allowed} in plan.contribution"
        )
        raise section.error("points", table.points, message)
    return Frontier(table.points, table.steps, table.level)


def read_reconcile(table: ReconcileTable | None) -> Reconcile | None:
    """The actuary's own figures, where given."""
    return None if table is None else Reconcile(table.liability, table.duration, table.tolerance)
