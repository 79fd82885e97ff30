"""Required own funds by the standard model: losses by risk, and their aggregation.

S1 rates, S2 shares and property, S3 currencies, S4 commodities, S5 credit, S6 insurance, S10 active
management; S7 to S9 are zero by law. Annex 3 of the Regeling Pensioenwet, article 2.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from ..records.regulation import MARKETS, Rules


@dataclass(frozen=True)
class Losses:
    """Losses of own funds by risk, money; `falling`: whether falling rates are the worse ones."""

    rates: float
    equity: float
    currencies: float
    commodities: float
    credit: float
    insurance: float
    active: float
    falling: bool


def total(rules: Rules, losses: Losses) -> float:
    """The required own funds: the root of squares and correlated products."""
    available = rules.correlations
    falling = 1.0 if losses.falling else 0.0
    s1, s2, s5 = losses.rates, losses.equity, losses.credit
    squares = sum(item**2 for item in astuple(losses)[:7])
    crossed = falling * (available["rates_equity"] * s1 * s2 + available["rates_credit"] * s1 * s5)
    return float(np.sqrt(squares + 2 * (crossed + available["equity_credit"] * s2 * s5)))


def correlated(parts: Sequence[float], correlation: float) -> float:
    """The root of the squares of `parts` and of their products, all with one correlation."""
    values = np.asarray(parts, float)
    squares = float(np.sum(values**2))
    return float(np.sqrt(squares + correlation * (values.sum() ** 2 - squares)))


def equity_loss(rules: Rules, held: dict[str, float]) -> float:
    """S2 of the market values {group: money} of shares and property; a group that is sold short has
    no loss, and its gain offsets no other loss."""
    names = ("developed", "emerging", "unlisted", "unlisted-property")
    parts = [rules.falls[name] * max(held.get(name, 0.0), 0.0) for name in names]
    return correlated(parts, rules.correlations["equity"])


def currency_loss(rules: Rules, exposed: Sequence[float], emerging: Sequence[bool]) -> float:
    """S3 of the unhedged exposures, money, each in a different currency."""
    sides = []
    for market, late in zip(MARKETS, (False, True)):
        local = [item for item, is_late in zip(exposed, emerging) if is_late == late]
        within = rules.correlations[f"currencies_{market}"]
        sides.append(rules.currencies[market] * correlated(local, within))
    return correlated(sides, rules.correlations["currencies"])


def shifted_discount(
    rules: Rules, factors: str, years: np.ndarray, discount: np.ndarray
) -> np.ndarray:
    """Discount factors after all annual zero rates were multiplied by the factors of a name."""
    due = np.where(years > 0, years, 1.0)
    rate = discount ** (-1 / due) - 1
    factor = np.interp(years, rules.term, rules.factors[factors])
    return np.where(years > 0, (1 + rate * factor) ** -due, discount)
