"""Reads `[plan]`, `[liability]` and `[reconcile]`: promises, contributions and their valuation.

A number that the rule of a case does not use is not an input: its `CaseInput` stays empty.
"""

import numpy as np

from snapo.case.csv import FileReference
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ..fund.contributions import CONTRIBUTIONS
from ..fund.increases import INCREASES
from ..quantities import input_of
from ..records.case import Frontier, PensionCase
from ..records.plan import Contribution, Indexation, Liability, PensionPlan, Reconcile, Revaluation
from .cash_plan import PlanClock, read_cash_plan
from .cells import WHOLE, TableReader, empty, years
from .tables import FrontierTable
from .tables_people import (
    ContributionTable,
    IndexationTable,
    LiabilityTable,
    PlanTable,
    ReconcileTable,
    RevaluationTable,
)

LIMITS = ("floor", "cap", "sponsor_limit")


def read_plan(
    section: TableContext,
    table: PlanTable,
    indexation: Indexation,
    revaluation: Revaluation | None,
    contribution: Contribution,
    money: str,
) -> PensionPlan:
    """Terms of the scheme; numbers left at a default of zero are not inputs."""

    def input(key: str) -> CaseInput:
        numbers = input_of(table, key, "plan", money)
        # A default share of one is an input, a default of zero is not.
        stated = key in table.model_fields_set or numbers.used() != 0
        return numbers if stated else _nothing(numbers.name)

    married = input("married_share") if table.spouse_share.used() else _nothing("married")
    return PensionPlan(
        timing=table.timing,
        retirement_age=table.retirement_age,
        accrual_rate=input("accrual_rate"),
        offset=input("offset"),
        spouse_share=input("spouse_share"),
        married_share=married,
        spouse_age_gap=table.spouse_age_gap,
        age_basis=table.age_basis,
        fractional_ages=table.fractional_ages,
        open=table.open,
        accruing=table.accruing,
        entry_age=table.entry_age,
        max_service=table.max_service,
        expenses=input("expenses"),
        indexation=indexation,
        contribution=contribution,
        revaluation=revaluation,
    )


def _nothing(name: str) -> CaseInput:
    return empty(name, ())


def _check_limits(section: TableContext, floor: CaseInput, cap: CaseInput) -> None:
    if floor.used() > cap.used():
        raise section.error("floor", floor.written, f"it must be at most cap, {cap.written:g}")


def read_indexation(section: TableContext, table: IndexationTable) -> Indexation:
    """Increases once a year; cap and floor only if the rule has them."""
    kind = table.kind
    used = INCREASES[kind].takes
    cuts = ["required_ratio"] if table.cut_years else []
    if kind == "fixed" and table.rate is None:
        raise section.error("rate", None, 'kind "fixed" needs this key')
    _check_limits(section, table.floor, table.cap)
    if "lower_ratio" in used and table.lower_ratio.used() >= table.upper_ratio.used():
        message = f"it must be less than upper_ratio, {table.upper_ratio.written:g}"
        raise section.error("lower_ratio", table.lower_ratio.written, message)

    def input(key: str) -> CaseInput:
        available = key in used or key in cuts
        return input_of(table, key, "indexation") if available else _nothing(f"indexation_{key}")

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
    """The rates of increase before payment; None if rights grow in the same way as pensions in
    payment."""
    if table is None:
        return None

    def input(key: str) -> CaseInput:
        return section.input(table, key, input_of(table, key, "revaluation"))

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
    if table.floor is not None and table.cap is not None:
        _check_limits(section, table.floor, table.cap)
    level = None
    if kind == "target" and table.recovery == "level":
        step, term = timer.grid.step, float(table.recovery_years.used())
        level = round(term / step)
        if not level or abs(level * step - term) > WHOLE:
            message = f"level payments must end after whole steps of {years(step)}"
            raise section.error("recovery_years", term, message)

    def input(name: str) -> CaseInput:
        # A default loading of zero is not an input.
        requested = name in used and (name != "loading" or name in table.model_fields_set)
        if name == "recovery_years" and level is not None:
            requested = False  # a date has no gradient
        if not requested:
            return _nothing(f"contribution_{name}")
        return input_of(table, name, "contribution", money)

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
    """The valuation of payments; `annual`: the compounding of the case."""
    requested = table.basis != "risk-free"
    if requested and table.rate is None:
        raise section.error("rate", None, f'basis "{table.basis}" needs this key')
    added = (
        _nothing("liability_rate") if table.rate is None else input_of(table, "rate", "liability")
    )
    loading = None
    if table.expense_loading.used():
        loading = input_of(table, "expense_loading", "liability")
    return Liability(table.basis, added, table.future_indexation, annual, loading)


def check_limited(case: PensionCase) -> None:
    """Checks whether the options in limited increases can be valued: increases must be limited, and
    the models must apply with constant volatilities.

    **Raises:** `CaseError` with the reason if the options cannot be valued.
    """
    if case.liability.future_indexation != "capped":
        return
    models = (case.rates.volatility, case.inflation.volatility, case.inflation.index_volatility)
    message = None
    if case.plan.indexation.kind != "capped":
        message = 'increases of plan.indexation are not limited: kind "capped" is needed'
    elif case.scenarios is not None:
        message = "ready-made scenarios have no volatilities, and options need them to be valued"
    elif any(np.ptp(model.used(), axis=0).any() for model in models):
        message = "options need volatilities of rates and inflation that do not change over time"
    if message is not None:
        raise CaseError(str(case.file), "liability.future_indexation", "capped", message)


def read_frontier(
    section: TableContext, table: FrontierTable | None, plan: PensionPlan
) -> Frontier | None:
    """The sweep of contributions against the shortfall, if requested."""
    if table is None:
        return None
    kind = plan.contribution.kind
    if not CONTRIBUTIONS[kind].responds:
        allowed = " or ".join(f'"{k}"' for k, rule in CONTRIBUTIONS.items() if rule.responds)
        message = (
            f'contributions of kind "{kind}" do not depend on decisions; a frontier needs the kind '
            f"{allowed} in plan.contribution"
        )
        raise section.error("points", table.points, message)
    return Frontier(table.points, table.steps, table.level)


def read_reconcile(table: ReconcileTable | None) -> Reconcile | None:
    """The actuary's figures, if specified."""
    return None if table is None else Reconcile(table.liability, table.duration, table.tolerance)
