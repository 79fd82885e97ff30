"""What an actuary moves each input by, and what the words for that are.

The convention of every sensitivity of a report: rates, spreads and fees per basis point, shares,
volatilities and ratios per percentage point, quantities (money, members, death probabilities) per
one per cent of themselves.
"""

from typing import NamedTuple

import numpy as np

from snapo.problem.inputs import Input

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
# What moves, by the beginning of an input's name; the longest that fits counts.
MEANINGS = {
    "": "the number rises; all others are held",
    "zero_rate": "KR01: the zero rate at one node, between nodes linearly; the sum of all nodes is"
    " a parallel shift. Market values of assets today, prices of risk and excess returns are held",
    "forward_rate": "KR01: the forward rate of one interval; the sum of all is a parallel shift."
    " Market values of assets today, prices of risk and excess returns are held",
    "ultimate": "the forward rate far beyond the last node",
    "break_even": "IE01: the break-even at one node, while nominal rates are held",
    "rate_volatility": "of a factor of the short rate; the curve is fitted again",
    "rate_mean_reversion": "of a factor of the short rate; the curve is fitted again",
    "rate_price_of_risk": "held while the curve moves; higher is a lower premium of long bonds",
    "inflation": "of expected inflation; break-evens are fitted again",
    "index": "of realised prices",
    "indexation": "a number of the rule of indexation",
    "real_wage_growth": "wages over prices",
    "wage_volatility": "of wages over prices",
    "asset_mean": "under excess returns the mean over cash, under total returns all of it",
    "asset_volatility": "of a class in its own currency, its mean as the case gives it",
    "asset_smoothing": "the share of a step's return that an appraisal shows at once",
    "asset_cost": "the share of what is traded that trading costs",
    "asset_fee": "per year, of what is held",
    "asset_weight": "a weight held today, before the first trade",
    "assets": "the market value of all assets today",
    "correlation": "an entry moves together with its mirror",
    "credit_spread": "the spread today, at unchanged prices of what is held",
    "credit_mean_spread": "where the spread reverts to",
    "credit": "of the logarithm of a spread",
    "credit_default_loss": "the share of a holding lost per year at the mean spread",
    "currency": "of a currency; what is hedged does not feel it",
    "overlay_notional": "the notional held today, before the first trade",
    "overlay": "a cost or limit of the swaps",
    "mortality_multiplier": "death rates at these ages rise by 1 % of themselves",
    "death_probability": "the probability rises by 1 % of itself",
    "improvement": "the yearly fall of death rates",
    "gompertz": "a number of the formula of mortality rises by 1 % of itself",
    "lee_carter": "a number of the mortality factor rises by 1 % of itself",
    "year_of_life": "all death rates fall in proportion, by sex, until the expectation of life at"
    " 65 is a year longer; to first order",
    "members": "the number of members of a cohort",
    "accrued_pension": "the yearly pension that each member has earned",
    "salary": "of each member, and with it contributions and accrual",
    "cash_flow": "an expected payment",
    "normal_cost": "the value of what a step accrues today",
    "payroll": "all salaries",
    "plan": "a number of the scheme's rules",
    "contribution": "a number of the rule of contributions",
    "liability_rate": "the rate that is added to the curve, or takes its place, in valuation",
}


def meaning(name: str) -> str:
    """What is moved when an input moves, and what is held meanwhile."""
    return MEANINGS[max((each for each in MEANINGS if name.startswith(each)), key=len)]


def move(name: str, given: Input) -> Move:
    """The usual step of an input; rises are positive."""
    ones = np.ones(given.value.size)
    if name in BY_TEN:
        return Move(10 * BASIS_POINT * ones, "10 bp")
    if name in ("contribution_recovery_years",):
        return Move(ones, "1 year")
    if name.startswith(BY_BASIS_POINT):
        return Move(BASIS_POINT * ones, "1 bp")
    if name.startswith(BY_SHARE_OF_ITSELF):
        return _share_of_itself(given.value.ravel())
    if "correlation" in name or "price_of_risk" in name or "mean_reversion" in name:
        return Move(POINT * ones, "0.01")
    return Move(POINT * ones, "1 percentage point")


def _share_of_itself(values: np.ndarray) -> Move:
    """One per cent; where all numbers are zero, one unit: there is no per cent of nothing."""
    if not values.any():
        return Move(np.ones(values.size), "1 unit")
    return Move(POINT * values, "1 % of itself")


def name_of(name: str, label: str = "") -> str:
    """An input in words: "Zero rate, 10y"."""
    words = name.replace("plan_", "").replace("_", " ").replace("lee carter", "Lee-Carter")
    words = words[:1].upper() + words[1:]
    return f"{words}, {label}" if label else words
