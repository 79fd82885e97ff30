"""A regulator's rules as resolved data: the state of the law at the valuation date, and the bases
of funding of the United Kingdom.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

RISKS = ("developed", "emerging", "unlisted", "unlisted-property", "commodity", "none")
MARKETS = ("developed", "emerging")


@dataclass(frozen=True, eq=False)
class Rules:
    """One state of the law; see the comments in `regulation/dutch_ftk.toml`.

    - `since`: the day from which it is in force. `term` [k]: years, with the `factors` {"rise",
      "fall", "real_rise", "real_fall": [k]} on annual zero rates.
    - `falls`, `currencies`, `spreads`, `correlations`: {name: number}, where shares and rates are
      fractions.
    """

    since: str
    source: str
    averaging_months: int
    recovery_years: float
    minimum: float
    term: np.ndarray
    factors: Mapping[str, np.ndarray]
    falls: Mapping[str, float]
    currencies: Mapping[str, float]
    spreads: Mapping[str, float]
    correlations: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Regulation:
    """The rules of a case, and the figures that they need in addition to its balance sheet.

    - `ratios`: funding ratios at the ends of the last months, the newest last; without any, the
      policy ratio is today's. `insurance_risk` (S6): a share of the liability; `active_risk`
      (S10): a share of the assets.
    """

    rules: Rules
    ratios: tuple[float, ...]
    insurance_risk: float
    active_risk: float


@dataclass(frozen=True)
class Funding:
    """Bases side by side; see the comments in `regulation/uk_funding.toml`.

    - `since`, `source`: date and source of the rules in force on the valuation date.
    - `margins`: {basis: margin of annual rates over the curve}, with technical provisions first.
    - `significant_maturity`: a duration in years. `recovery_years`: the length of the recovery
      plan; None for the longest that the rules allow, `longest` before and `mature` at significant
      maturity.
    """

    since: str
    source: str
    margins: dict[str, float]
    significant_maturity: float
    longest: float
    mature: float
    recovery_years: float | None
