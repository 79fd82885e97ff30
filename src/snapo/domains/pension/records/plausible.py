"""Ranges outside which a number of a fund is likely to be in another unit; such a number causes a
note.

The ranges are wide: a fund outside one of them is possible, and its actuary knows why.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from snapo.case.plausible import FRACTION, CaseFiles, CheckedNumbers, Plausible, implausible

from .case import PensionCase
from .inputs import every_given
from .market import MarketCurve
from .people import ACTIVE

RATE = (-0.02, 0.15)  # zero rates, continuous
FORWARD = (-0.05, 0.2)
MAJOR = ("EUR", "GBP", "USD", "CHF")  # currencies of which a salary has a usual size
YEARLY = "a fraction per year is expected (0.02 is 2 %)"
MONEY = "is it in the same unit as the other amounts of the case?"
SHARE = "a fraction is expected (0.05 is 5 %)"


def _by_name(low: float, high: float, hint: str, *names: str, by_size: bool = False) -> Plausible:
    return Plausible(low, high, hint, names=names, by_size=by_size)


RANGES = (
    _by_name(*RATE, FRACTION, "zero_rate", "swap_rate", "ultimate_forward", "liability_rate"),
    _by_name(*FORWARD, FRACTION, "forward_rate", "forward rate", "forward break-even"),
    _by_name(-0.03, 0.12, FRACTION, "break_even", "ultimate_break_even"),
    _by_name(0.02, 120.0, "tenors are in years", "curve tenor", "break-even tenor"),
    _by_name(0.0005, 3.0, "it is per year", "rate_mean_reversion"),
    _by_name(0.01, 10.0, "it is per year", "inflation_mean_reversion", "credit_mean_reversion"),
    _by_name(0.0002, 0.05, "0.008 is 0.8 % a year", "rate_volatility", "inflation_volatility",
             "index_volatility", "wage_volatility"),
    _by_name(0.0, 1.5, "it is a premium per unit of volatility", "rate_price_of_risk",
             "inflation_price_of_risk", "index_price_of_risk", by_size=True),
    _by_name(-0.05, 0.05, YEARLY, "real_wage_growth", "currency_premium"),
    _by_name(-0.1, 0.2, YEARLY, "asset_mean"),
    _by_name(0.01, 0.6, "0.2 is 20 % a year", "asset_volatility", "currency_volatility"),
    _by_name(0.01, 1.0, SHARE, "asset_smoothing", "currency_hedge_ratio"),
    _by_name(0.0, 0.1, "it is a share of the trade (0.001 is 10 bp)", "asset_cost", "overlay_cost"),
    _by_name(0.0, 0.05, "it is a share of the holding a year (0.001 is 10 bp)", "asset_fee",
             "currency_hedge_cost"),
    _by_name(-3.0, 3.0, "a fraction of the assets is expected (0.05 is 5 %)", "asset_weight"),
    _by_name(-0.02, 0.25, YEARLY, "credit_spread", "credit_mean_spread"),
    _by_name(0.01, 2.0, "it is the volatility of the logarithm of the spread (0.35 is 35 %)",
             "credit_volatility"),
    _by_name(0.0, 0.15, YEARLY, "credit_default_loss"),
    _by_name(0.0, 20.0, "1 is a notional as large as the assets", "overlay_leverage"),
    _by_name(0.002, 0.1, "a rise in rates as a fraction is expected (0.035 is 350 bp)",
             "overlay_collateral_stress"),
    _by_name(0.5, 1e7, "it is the number of members", "members"),
    _by_name(0.0, 60.0, "service is in years", "service"),
    _by_name(1e-6, 1.0, "a probability for one year is expected", "death_probability"),
    _by_name(0.001, 0.2, "it is exp(alpha + 65 beta) + makeham a year", "hazard at 65"),
    _by_name(0.1, 5.0, "it is a factor (0.95 is 95 %)", "mortality_multiplier", "member_mortality"),
    _by_name(-0.05, 0.06, YEARLY, "improvement"),
    _by_name(0.01, 5.0, "it is per square root of a year", "lee_carter_volatility"),
    _by_name(0.0, 5.0, "it is the response of the hazard to the mortality factor",
             "lee_carter_loading", by_size=True),
    _by_name(0.002, 0.05, "it is the share of the salary that a year of service earns "
             "(1/60 is 0.0167)",
             "plan_accrual_rate"),
    _by_name(0.05, 1.0, SHARE, "plan_spouse_share", "plan_married_share"),
    _by_name(-0.02, 0.12, YEARLY, "revaluation_deferred", "revaluation_active",
             "indexation_rate"),
    _by_name(-0.1, 0.2, YEARLY, "indexation_cap", "indexation_floor"),
    _by_name(0.4, 2.5, "a ratio is expected (1.05 is 105 %)", "indexation_lower_ratio",
             "indexation_upper_ratio", "indexation_required_ratio", "contribution_target_ratio",
             "policy ratio"),
    _by_name(0.002, 1.5, "it is a share of salaries (0.2 is 20 %)", "contribution_rate",
             "contribution_floor", "contribution_cap"),
    _by_name(0.0, 1.0, SHARE, "contribution_loading", "contribution_spread_factor"),
    _by_name(0.5, 40.0, "it is a number of years", "contribution_recovery_years",
             "funding recovery years"),
    _by_name(0.0, 0.3, SHARE, "liability_expense_loading"),
    _by_name(-0.02, 0.05, "a margin of rates is expected (0.005 is 50 bp)", "funding margin"),
    _by_name(0.0, 0.5, SHARE, "reserve_today", "reserve_fill_contribution", "reserve_fill_return",
             "reserve_release", "reserve_largest", "insurance risk", "active risk"),
    _by_name(0.0, 5.0, "a weight is expected (0.8 is 80 %)", "pot_protection", "pot_exposure"),
    _by_name(0.0, 0.1, "a shift of rates as a fraction is expected (0.01 is 100 bp)",
             "stress shift", by_size=True),
    _by_name(-1.0, 5.0, "a fraction is expected (-0.3 is a fall by 30 %)", "stress factor"),
    _by_name(-0.9, 2.0, "a simple return of the step is expected (0.01 is 1 %)", "scenario return"),
    _by_name(-0.2, 0.3, "a logarithmic growth of the step is expected", "scenario growth"),
    _by_name(-0.05, 0.25, FRACTION, "scenario zero"),
)  # fmt: skip


def unit_slips(
    case: PensionCase, data: Mapping[str, Any], shocks: Iterable[CheckedNumbers]
) -> dict[str, str]:
    """{input: note} of numbers that are likely to be in another unit.

    `data`: the tables of the case; `shocks`: the sizes of its stresses.
    """
    entries = [*every_given(case), *_derived(case), *shocks]
    return implausible(entries, [*RANGES, *amounts(case)], CaseFiles(case.file, data))


def amounts(case: PensionCase) -> Iterator[Plausible]:
    """The ranges of money, by its currency and by the size of the fund."""
    if case.members is not None:
        if case.members.salary.values.size:
            yield _salaries(case)
        low = 50.0 if case.currency in MAJOR else 0.0
        hint = f"a pension of a member is in {case.currency} a year"
        yield _by_name(low, 3e5 if low else np.inf, hint, "accrued_pension")
        hint = f"the part of a salary that earns no pension is in {case.currency} a year"
        yield _by_name(low, 3e5 if low else np.inf, hint, "plan_offset")
    size = _size(case)
    hint = f"the fund has about {case.currency} {size:,.3g}; {MONEY}"
    yield _by_name(1e-6 * size, 0.05 * size, hint, "plan_expenses")
    yield _by_name(1e-6 * size, size, hint, "contribution_sponsor_limit", "contribution_schedule")
    yield _by_name(1e-6 * size, 10 * size, hint, "overlay_notional", by_size=True)
    yield _by_name(0.0, size, hint, "cash_flow", "normal_cost", "payroll", by_size=True)


def _size(case: PensionCase) -> float:
    """The assets, or 15 years of all pensions if that is more, since one of them has the right
    unit."""
    owed = 0.0
    if case.members is not None:
        owed = 15 * float(case.members.number.used() @ case.members.pension.used())
    if case.cash_flows is not None:
        owed = float(np.abs(case.cash_flows.amount.values).sum())
    return max(float(case.assets.amount.used()), owed)


def _salaries(case: PensionCase) -> Plausible:
    """The range of salaries: that of their currency, or above the offset if no salary is."""
    assert case.members is not None
    salary = case.members.salary.used()[case.members.status == ACTIVE]
    offset = float(case.plan.offset.used()) if case.plan.offset.values.size else 0.0
    if salary.size and case.plan.accruing and salary.max() <= offset:
        hint = f"plan.offset is {offset:,.6g}, so that no active member accrues a pension"
        return _by_name(np.nextafter(offset, np.inf), np.inf, hint, "salary")
    if case.currency in MAJOR:
        hint = f"a salary of a member is in {case.currency} a year"
        return _by_name(3000.0, 1e6, hint, "salary")
    return _by_name(0.0, np.inf, "", "salary")


def _derived(case: PensionCase) -> Iterator[CheckedNumbers]:
    """Forward rates between nodes, and numbers of the case that have no sensitivity."""
    yield from _forwards(case.curve, "forward rate", "curve tenor")
    yield from _forwards(case.inflation.break_even, "forward break-even", "break-even tenor")
    if case.members is not None:
        yield CheckedNumbers("service", case.members.service, case.members.names, "year")
    if case.mortality is not None and case.mortality.gompertz.values.size:
        alpha, beta, makeham = case.mortality.gompertz.used().T
        hazard = makeham + np.exp(alpha + beta * 65)
        yield CheckedNumbers(
            "hazard at 65", hazard, ("male", "female"), "1/year", source="gompertz"
        )
    if case.regulation is not None and case.regulation.ratios:
        ratios = np.array(case.regulation.ratios)
        labels = tuple(f"of month {i + 1}" for i in range(ratios.size))
        yield CheckedNumbers("policy ratio", ratios, labels)
    if case.regulation is not None:
        yield _single("insurance risk", case.regulation.insurance_risk)
        yield _single("active risk", case.regulation.active_risk)
    if case.funding is not None:
        margins = case.funding.margins
        values = np.array(list(margins.values()))
        yield CheckedNumbers("funding margin", values, tuple(margins), "1/year", "", "bp", 1e4)
        if case.funding.recovery_years is not None:
            yield _single("funding recovery years", case.funding.recovery_years, "year")
    if case.scenarios is not None:
        yield from _scenarios(case)


def _single(name: str, value: float, unit: str = "") -> CheckedNumbers:
    return CheckedNumbers(name, np.array([value]), ("",), unit)


def _forwards(curve: MarketCurve, name: str, tenor: str) -> Iterator[CheckedNumbers]:
    """Tenors of a curve, and the forward rates between the nodes of zero rates."""
    labels = curve.rate.labels
    yield CheckedNumbers(tenor, curve.tenor, labels, "year")
    if curve.quote == "zero":
        times = np.concatenate([[0.0], curve.tenor])
        paid = np.concatenate([[0.0], curve.tenor * curve.rate.values])
        forward = np.diff(paid) / np.diff(times)
        between = tuple(f"up to {label}" for label in labels)
        unit = (curve.rate.unit, curve.rate.group, "bp", 1e4, curve.rate.values, curve.rate.name)
        yield CheckedNumbers(name, forward, between, *unit)


def _scenarios(case: PensionCase) -> Iterator[CheckedNumbers]:
    """The lowest and the highest number of every column of ready-made scenarios."""
    assert case.scenarios is not None
    both = (case.scenarios.training, case.scenarios.evaluation)
    for i, column in enumerate(case.scenarios.columns):
        kind = column.partition(" ")[0]
        name = f"scenario {kind if kind in ('return', 'zero') else 'growth'}"
        values = np.array([f(paths[:, :, i]) for f in (np.min, np.max) for paths in both])
        labels = tuple(f"{column} in {role}" for role in ("training", "evaluation")) * 2
        yield CheckedNumbers(name, values, labels)
