"""What an actuary moves each input by, and what the words for that are.

The convention of every sensitivity of a report: rates, spreads and fees per basis point, shares,
volatilities and ratios per percentage point, quantities (money, members, death probabilities) per
one per cent of themselves.
"""

from typing import NamedTuple

import numpy as np

from ...inputs import Input

BASIS_POINT, POINT = 1e-4, 0.01


class Move(NamedTuple):
    """How far each number of an input is moved [n], and the words."""

    size: np.ndarray
    words: str


# Inputs by the beginning of their name; the longest that fits counts.
BY_BASIS_POINT = (
    "zero_rate",
    "forward_rate",
    "ultimate_",
    "break_even",
    "real_wage_growth",
    "asset_fee",
    "asset_cost",
    "overlay_cost",
    "credit_spread",
    "credit_mean_spread",
    "credit_default_loss",
    "currency_premium",
    "currency_hedge_cost",
    "liability_rate",
    "indexation_cap",
    "indexation_floor",
    "improvement",
    "plan_accrual_rate",
)
# Volatilities of rates and growth are small: a point would double them.
BY_TEN = ("rate_volatility", "inflation_volatility", "index_volatility", "wage_volatility")
BY_SHARE_OF_ITSELF = (
    "assets",
    "members",
    "accrued_pension",
    "salary",
    "death_probability",
    "mortality_multiplier",
    "cash_flow",
    "normal_cost",
    "payroll",
    "overlay_notional",
    "plan_expenses",
    "plan_offset",
    "contribution_sponsor_limit",
    "gompertz",
    "lee_carter",
)
DEFINITIONS = {
    "zero_rate": "KR01: the zero rate at one node rises by 1 bp, between nodes linearly; the sum of"
    " all nodes is a parallel shift. Market values of assets today are held",
    "forward_rate": "KR01: the forward rate of one interval rises by 1 bp; the sum of all is a"
    " parallel shift. Market values of assets today are held",
    "break_even": "IE01: the break-even at one node rises by 1 bp while nominal rates are held",
    "rate_price_of_risk": "held while the curve moves; moved here by 0.01",
    "asset_mean": "under excess returns the mean is over cash, under total returns all of it",
    "correlation": "an entry moves together with its mirror",
    "mortality_multiplier": "mortality at these ages rises by 1 % of itself",
    "death_probability": "the probability rises by 1 % of itself",
}


def move(name: str, given: Input) -> Move:
    """The usual step of an input; rises are positive."""
    ones = np.ones(given.value.size)
    if name in BY_TEN:
        return Move(10 * BASIS_POINT * ones, "10 bp")
    if name in ("contribution_recovery_years",):
        return Move(ones, "1 year")
    if name.startswith(BY_BASIS_POINT):
        return Move(BASIS_POINT * ones, "1 bp")
    if name.startswith(BY_SHARE_OF_ITSELF) and name not in ("asset_smoothing",):
        return Move(POINT * given.value.ravel(), "1 % of itself")
    if "correlation" in name or "price_of_risk" in name or "mean_reversion" in name:
        return Move(POINT * ones, "0.01")
    return Move(POINT * ones, "1 percentage point")


def name_of(name: str, label: str = "") -> str:
    """An input in words: "Zero rate, 10y"."""
    words = name.replace("plan_", "").replace("_", " ").replace("lee carter", "Lee-Carter")
    words = words[:1].upper() + words[1:]
    return f"{words}, {label}" if label else words
