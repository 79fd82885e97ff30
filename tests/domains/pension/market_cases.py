"""Pension cases built by hand for the tests of markets, assets and the simulator."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.market.assets.cash import Cash
from snapo.domains.pension.market.assets.credit import CreditBond
from snapo.domains.pension.market.assets.priced import Equity, Property
from snapo.domains.pension.market.rates.short_rate import G2, HullWhite, ShortRate
from snapo.domains.pension.records.assets import AssetGroup, Assets, Overlay
from snapo.domains.pension.records.case import ObjectiveTerm, PensionCase
from snapo.domains.pension.records.market import (
    Correlation,
    Credit,
    Currencies,
    Inflation,
    MarketCurve,
)
from snapo.domains.pension.records.people import CashFlows
from snapo.domains.pension.records.plan import Contribution, Indexation, Liability, PensionPlan


def given(name: str, values, index=None, unit="1") -> CaseInput:
    """A number or a row of numbers; `index` where it is used, by default each once."""
    values = np.asarray(values, float)
    shape = values.shape
    flat = values.ravel()
    labels = ("",) if not shape else tuple(str(i) for i in range(len(flat)))
    places = np.arange(len(flat)).reshape(shape) if index is None else index
    return CaseInput(name, flat, labels, unit, places)


def steady(name: str, values, steps: int, unit="1/sqrt(year)") -> CaseInput:
    """The same number in every step: index [T] for one, [T, m] for several."""
    values = np.asarray(values, float)
    places = np.broadcast_to(np.arange(values.size).reshape(values.shape), (steps, *values.shape))
    return given(name, values, places, unit)


def none(name: str, *shape: int) -> CaseInput:
    return CaseInput(name, np.zeros(0), (), "1", np.zeros(shape, int))


def curve(name: str, tenor, rate, quote="zero") -> MarketCurve:
    return MarketCurve(
        np.asarray(tenor, float), given(name, rate), quote, "flat-forward", none(f"{name}_far")
    )


def rates(steps: int, a=0.03, s=0.01, price=0.0) -> ShortRate:
    """Hull-White, or G2++ where two numbers are given."""
    a, s, price = (
        np.atleast_1d(a),
        np.atleast_1d(s),
        np.broadcast_to(price, np.shape(np.atleast_1d(a))),
    )
    return (HullWhite if len(a) == 1 else G2)(
        given("rate_mean_reversion", a),
        steady("rate_volatility", s, steps),
        given("rate_price_of_risk", price),
    )


def inflation(steps: int, break_even, *, volatility=0.0, index=0.0, price=0.0, wage=(0.0, 0.0)):
    return Inflation(
        break_even,
        given("inflation_mean_reversion", 0.3),
        steady("inflation_volatility", volatility, steps),
        given("inflation_price_of_risk", price),
        steady("index_volatility", index, steps),
        given("index_price_of_risk", price),
        given("real_wage_growth", wage[0]),
        given("wage_volatility", wage[1]),
    )


def assets(
    steps: int,
    classes,
    *,
    mean=(),
    volatility=(),
    weight,
    return_kind="excess",
    mean_kind="log",
    amount=100.0,
    cost=None,
    fee=None,
    smoothed=(),
    high=None,
    groups=(),
) -> Assets:
    classes = tuple(classes)
    n = len(classes)
    return Assets(
        classes=classes,
        return_kind=return_kind,
        mean_kind=mean_kind,
        mean=given("asset_mean", np.asarray(mean, float)),
        volatility=steady("asset_volatility", np.asarray(volatility, float), steps),
        smoothing=given("asset_smoothing", np.full(len(smoothed), 0.4)),
        smoothed=np.array(smoothed, int),
        cost=none("asset_cost", n) if cost is None else given("asset_cost", cost),
        fee=none("asset_fee", n) if fee is None else given("asset_fee", fee),
        weight=given("asset_weight", weight),
        low=np.zeros(n),
        high=np.ones(n) if high is None else np.asarray(high, float),
        groups=groups,
        amount=given("assets", amount),
    )


CASH, EQUITY = Cash("Cash", eligible=1.0), Equity("Equity")


def plan(timing="arrears", indexation="none", **changes) -> PensionPlan:
    base = PensionPlan(
        timing=timing,
        retirement_age=67.0,
        accrual_rate=given("accrual_rate", 0.0),
        offset=given("plan_offset", 0.0),
        spouse_share=given("plan_spouse_share", 0.0),
        married_share=given("plan_married_share", 1.0),
        spouse_age_gap=3,
        age_basis="exact",
        fractional_ages="constant-force",
        open=False,
        accruing=False,
        entry_age=25.0,
        max_service=60.0,
        expenses=given("expenses", 0.0),
        indexation=Indexation(
            indexation,
            1,
            12,
            given("indexation_cap", 0.5),
            given("indexation_floor", -0.5),
            given("indexation_lower_ratio", 1.0),
            given("indexation_upper_ratio", 1.3),
            given("indexation_required_ratio", 1.0),
            0,
        ),
        contribution=no_contribution(),
    )
    return replace(base, **changes)


def no_contribution(kind="none", **values) -> Contribution:
    usual = {
        "rate": 0.0,
        "loading": 0.0,
        "spread_factor": 0.1,
        "target_ratio": 1.0,
        "recovery_years": 10.0,
        "floor": 0.0,
        "cap": 0.0,
        "sponsor_limit": 0.0,
    } | values
    numbers = {key: given(f"contribution_{key}", value) for key, value in usual.items()}
    return Contribution(
        kind=kind, normal_cost="valuation", **numbers, has_floor=False, has_cap=False,
        has_sponsor_limit=False,
    )  # fmt: skip


def cash_flows(amounts, steps, normal_cost=0.0, salary=0.0) -> CashFlows:
    return CashFlows(
        given("cash_flow", amounts),
        np.asarray(steps, int),
        given("normal_cost", normal_cost),
        given("payroll", salary),
    )


def case(steps: int, *, held_assets: Assets, flows: CashFlows | None = None, **changes):
    """A case of cash flows: Hull-White rates at 2 % with no volatility, no inflation, measure P."""
    tenor = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0]
    usual = {
        "file": Path("by_hand.toml"),
        "title": "By hand",
        "currency": "EUR",
        "valuation_date": "2024-12-31",
        "step": 1 / 12,
        "steps": steps,
        "start_month": 1,
        "measure": "P",
        "curve": curve("zero_rate", tenor, [0.02] * 6),
        "rates": rates(steps, s=0.0),
        "inflation": inflation(steps, curve("break_even", [1.0, 10.0, 30.0], [0.02] * 3)),
        "assets": held_assets,
        "credit": Credit((), *(none(f"credit_{i}", 0) for i in range(5))),
        "currencies": Currencies((), *(none(f"currency_{i}", 0) for i in range(4))),
        "correlation": Correlation((), none("correlation", 0)),
        "overlay": None,
        "members": None,
        "mortality": None,
        "lee_carter": None,
        "cash_flows": cash_flows([1.0], [0]) if flows is None else flows,
        "plan": plan(),
        "liability": Liability("risk-free", given("liability_rate", 0.0), "none"),
        "reconcile": None,
        "scenarios": None,
        "observation": ("time",),
        "hidden": (8,),
        "objective": (
            ObjectiveTerm(1.0, "funding_ratio", ObjectiveTable(kind="crra", risk_aversion=5.0)),
        ),
        "training": TrainingTable(),
        "evaluation": EvaluationTable(),
    }
    return PensionCase(**usual | changes)


def full(steps: int = 6, **changes) -> PensionCase:
    """Every kind of asset, factor and rule at once, over a short horizon."""
    classes = [
        CASH,
        EQUITY,
        Equity("World", currency=0),
        Property("Property"),
        Bond("Government", maturity=120, eligible=0.9),
        CreditBond("Corporate", maturity=60, rating=0),
        CreditBond("Dollar credit", maturity=84, rating=1, currency=0),
    ]
    names = ("rate", "rate 2", "inflation", "price index", "Equity", "World", "A", "USD")
    lower = np.linspace(-0.2, 0.25, len(names) * (len(names) - 1) // 2)
    tenor = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0]
    months = np.arange(0, 480, 12)
    usual = {
        "held_assets": assets(
            steps,
            classes,
            mean=[0.035, 0.04, 0.025],
            volatility=[0.18, 0.2, 0.12],
            weight=[0.05, 0.2, 0.15, 0.1, 0.2, 0.2, 0.1],
            high=[0.5, 0.4, 0.3, 0.2, 0.5, 0.4, 0.3],
            groups=(AssetGroup("growth", (1, 2, 3), 0.2, 0.6),),
            mean_kind="arithmetic",
            cost=[0.0, 0.001, 0.0012, 0.01, 0.0005, 0.002, 0.0025],
            fee=[0.0, 0.001, 0.002, 0.005, 0.001, 0.002, 0.002],
            smoothed=(3,),
        ),
        "flows": cash_flows(5.5 * np.exp(-0.02 * months / 12), months, 0.05, 10.0),
        "curve": curve("zero_rate", tenor, [0.02, 0.021, 0.023, 0.025, 0.026, 0.0255]),
        "rates": rates(steps, [0.05, 0.4], [0.009, 0.006], [-0.1, -0.05]),
        "inflation": inflation(
            steps,
            curve("break_even", [1.0, 5.0, 30.0], [0.018, 0.02, 0.022]),
            volatility=0.007,
            index=0.011,
            price=0.05,
            wage=(0.004, 0.008),
        ),
        "credit": Credit(
            ("A", "BBB"),
            given("credit_spread", [0.008, 0.015]),
            given("credit_mean_spread", [0.01, 0.017]),
            given("credit_mean_reversion", [0.4, 0.5]),
            given("credit_volatility", [0.4, 0.35]),
            given("credit_default_loss", [0.001, 0.003]),
        ),
        "currencies": Currencies(
            ("USD",),
            given("currency_volatility", [0.09]),
            given("currency_premium", [0.002]),
            given("currency_hedge_ratio", [0.5]),
            given("currency_hedge_cost", [0.003]),
        ),
        "correlation": Correlation(names, given("correlation", lower)),
        "overlay": Overlay(
            maturities=np.array([120, 240]),
            notional=given("overlay_notional", [8.0, 10.0]),
            low=np.zeros(2),
            high=np.array([0.4, 0.5]),
            unit="liability",
            leverage=given("overlay_leverage", 0.3),
            cost=given("overlay_cost", [0.0002, 0.0003]),
            collateral_stress=given("overlay_collateral_stress", 0.035),
            zero_coupon=(1,),
        ),
        "plan": plan(indexation="conditional", expenses=given("expenses", 0.3),
                     contribution=no_contribution("spread")),
        "start_month": 9,
        "observation": (
            "time", "funding_ratio", "rates", "long_rate", "short_rate", "inflation",
            "realised_inflation", "spreads", "weights", "overlay", "accrued",
        ),
    }  # fmt: skip
    return case(steps, **usual | changes)
