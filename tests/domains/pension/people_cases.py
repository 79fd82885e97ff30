"""Small pension cases built by hand, for what concerns members, plan and liability."""

from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.settings import EvaluationTable, TrainingTable
from snapo.domains.pension.market.assets.cash import Cash
from snapo.domains.pension.market.rates.short_rate import HullWhite
from snapo.domains.pension.records.assets import Assets
from snapo.domains.pension.records.case import PensionCase
from snapo.domains.pension.records.market import (
    Correlation,
    Credit,
    Currencies,
    Inflation,
    MarketCurve,
)
from snapo.domains.pension.records.people import (
    ACTIVE,
    DEFERRED,
    FEMALE,
    MALE,
    PENSIONER,
    SPOUSE,
    CashFlows,
    FundMembers,
    LeeCarter,
    Mortality,
)
from snapo.domains.pension.records.plan import Contribution, Indexation, Liability, PensionPlan

FIRST_AGE, AGES = 20, 91
# Gompertz fit to the US period life table 2017, ages 60 to 95: alpha, beta, and no Makeham term.
GOMPERTZ = np.array([[-10.44730, 0.095853, 0.0], [-11.51027, 0.104929, 0.0]])


def given(name: str, values: Any, index: Any = None) -> CaseInput:
    """Numbers under a name; by default each stands for itself."""
    array = np.asarray(values, float)
    place = np.arange(array.size).reshape(array.shape) if index is None else np.asarray(index)
    return CaseInput(name, array.ravel(), tuple(map(str, range(array.size))), "1", place)


def nothing(name: str, shape: tuple[int, ...] = ()) -> CaseInput:
    return CaseInput(name, np.zeros(0), (), "1", np.zeros(shape, int))


def gompertz_table() -> np.ndarray:
    """Death probabilities [2, AGES] of the fit; nobody survives the last age."""
    age = FIRST_AGE + np.arange(AGES)
    hazard = np.exp(GOMPERTZ[:, :1] + GOMPERTZ[:, 1:2] * age) * np.expm1(GOMPERTZ[:, 1:2])
    q = -np.expm1(-hazard / GOMPERTZ[:, 1:2])
    q[:, -1] = 1.0
    return q


def mortality(kind: Any = "table", table: np.ndarray | None = None, **changes: Any) -> Mortality:
    table = gompertz_table() if table is None else table
    size = (2, table.shape[1])
    old = np.where(np.arange(size[1]) < 45, 0, 1) + np.array([[0], [2]])
    fields: dict[str, Any] = {
        "first_age": FIRST_AGE,
        "table": given("death_probability", table)
        if kind == "table"
        else nothing("death_probability", size),
        "gompertz": given("gompertz", GOMPERTZ) if kind != "table" else nothing("gompertz", (2, 3)),
        "multiplier": given("mortality_multiplier", [0.9, 1.0, 0.95, 1.05], old),
        "improvement": given(
            "improvement", [0.012, 0.01], np.array([[0], [1]]) + np.zeros(size, int)
        ),
    }
    return Mortality(kind=kind, ages=size[1], **(fields | changes))


def lee_carter() -> LeeCarter:
    """Responses that fall with age, as in the US from 1970 to 2017."""
    age = FIRST_AGE + np.arange(AGES)
    loading = np.interp(age, [40, 65, 80, 100], [0.02, 0.02538, 0.01807, 0.005])
    return LeeCarter(
        given("lee_carter_volatility", 0.6), given("loading", [loading, 0.9 * loading])
    )


def members(**changes: Any) -> FundMembers:
    fields: dict[str, Any] = {
        "names": ("young", "old", "deferred", "pensioner", "widow"),
        "status": np.array([ACTIVE, ACTIVE, DEFERRED, PENSIONER, SPOUSE]),
        "sex": np.array([MALE, FEMALE, FEMALE, MALE, FEMALE]),
        "age": np.array([35.0, 62.0, 50.0, 70.0, 76.0]),
        "number": given("members", [100.0, 80.0, 60.0, 50.0, 20.0]),
        "pension": given("accrued_pension", [3.0, 12.0, 6.0, 15.0, 9.0]),
        # As a file is read: who is not active points at a number that is not meant.
        "salary": given("salary", [40.0, 45.0], [0, 1, 0, 0, 0]),
        "service": np.array([6.0, 25.0, 12.0, 30.0, 0.0]),
    }
    return FundMembers(**(fields | changes))


def cash_flows(amounts: Any, steps: Any, normal_cost: float = 0.0, salary: float = 0.0):
    return CashFlows(
        given("cash_flow", amounts),
        np.asarray(steps),
        given("normal_cost", normal_cost),
        given("payroll", salary),
    )


def indexing(kind: Any = "conditional", **changes: Any) -> Indexation:
    fields: dict[str, Any] = {
        "month": 1,
        "averaging": 12,
        "cap": given("indexation_cap", 0.03),
        "floor": given("indexation_floor", 0.0),
        "lower_ratio": given("indexation_lower_ratio", 1.05),
        "upper_ratio": given("indexation_upper_ratio", 1.25),
        "required_ratio": given("indexation_required_ratio", 1.0),
        "cut_years": 5,
    }
    return Indexation(kind, **(fields | changes))


def contributing(kind: Any = "spread", **changes: Any) -> Contribution:
    fields: dict[str, Any] = {
        "normal_cost": "valuation",
        "rate": given("contribution_rate", 0.2),
        "loading": given("contribution_loading", 0.05),
        "spread_factor": given("contribution_spread_factor", 0.1),
        "target_ratio": given("contribution_target_ratio", 1.1),
        "recovery_years": given("contribution_recovery_years", 8.0),
        "floor": given("contribution_floor", 0.05),
        "cap": given("contribution_cap", 0.4),
        "sponsor_limit": given("contribution_sponsor_limit", 5000.0),
        "has_floor": False,
        "has_cap": False,
        "has_sponsor_limit": False,
    }
    return Contribution(kind, **(fields | changes))


def plan(**changes: Any) -> PensionPlan:
    fields: dict[str, Any] = {
        "timing": "advance",
        "retirement_age": 67.0,
        "accrual_rate": given("plan_accrual_rate", 0.0175),
        "offset": given("plan_offset", 15.0),
        "spouse_share": given("plan_spouse_share", 0.7),
        "married_share": given("plan_married_share", 0.65),
        "spouse_age_gap": 3,
        "age_basis": "nearest",
        "fractional_ages": "constant-force",
        "open": False,
        "accruing": True,
        "entry_age": 25.0,
        "max_service": 60.0,
        "expenses": given("plan_expenses", 24.0),
        "indexation": indexing(),
        "contribution": contributing(),
    }
    return PensionPlan(**(fields | changes))


def _curve(name: str, rates: Any) -> MarketCurve:
    tenor = np.array([1.0, 5.0, 10.0, 20.0, 30.0])
    return MarketCurve(tenor, given(name, rates), "zero", "flat-forward", nothing("ultimate"))


def _assets() -> Assets:
    return Assets(
        classes=(Cash("Cash"),),
        return_kind="excess",
        mean_kind="log",
        mean=nothing("asset_mean", (0,)),
        volatility=nothing("asset_volatility", (0, 0)),
        smoothing=nothing("asset_smoothing", (0,)),
        smoothed=np.zeros(0, int),
        cost=given("asset_cost", [0.0]),
        fee=given("asset_fee", [0.0]),
        weight=given("asset_weight", [1.0]),
        low=np.zeros(1),
        high=np.ones(1),
        groups=(),
        amount=given("assets", 10000.0),
    )


def people_case(steps: int = 6, **changes: Any) -> PensionCase:
    """A fund of five cohorts with all that its liabilities can have, but the mortality factor."""
    inflation = Inflation(
        break_even=_curve("break_even", [0.018, 0.019, 0.02, 0.021, 0.021]),
        mean_reversion=given("inflation_mean_reversion", 0.3),
        volatility=given("inflation_volatility", 0.007, np.zeros(steps, int)),
        price_of_risk=nothing("inflation_price_of_risk"),
        index_volatility=given("index_volatility", 0.01, np.zeros(steps, int)),
        index_price_of_risk=nothing("index_price_of_risk"),
        real_wage_growth=given("real_wage_growth", 0.004),
        wage_volatility=nothing("wage_volatility"),
    )
    fields: dict[str, Any] = {
        "file": Path("case.toml"),
        "title": "People",
        "currency": "EUR",
        "valuation_date": "2024-12-31",
        "step": 1 / 12,
        "start_month": 1,
        "measure": "Q",
        "curve": _curve("zero_rate", [0.02, 0.022, 0.024, 0.026, 0.025]),
        "rates": HullWhite(
            given("rate_mean_reversion", [0.03]),
            given("rate_volatility", [0.01], np.zeros((steps, 1), int)),
            nothing("rate_price_of_risk", (1,)),
        ),
        "inflation": inflation,
        "assets": _assets(),
        "credit": Credit((), *(nothing("credit", (0,)) for _ in range(5))),
        "currencies": Currencies((), *(nothing("currency", (0,)) for _ in range(4))),
        "correlation": Correlation((), nothing("correlation", (0,))),
        "overlay": None,
        "members": members(),
        "mortality": mortality(),
        "lee_carter": None,
        "cash_flows": None,
        "plan": plan(),
        "liability": Liability("risk-free", given("liability_rate", 0.01), "none"),
        "reconcile": None,
        "scenarios": None,
        "observation": ("time",),
        "hidden": (),
        "objective": (),
        "training": TrainingTable(),
        "evaluation": EvaluationTable(),
    }
    return PensionCase(steps=steps, **(fields | changes))
