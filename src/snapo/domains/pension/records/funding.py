"""The United Kingdom's bases of funding as resolved data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Funding:
    """Bases side by side; see the comments in `regulation/uk_funding.toml`.

    - `since`, `source`: of the rules in force at the valuation date.
    - `margins`: {basis: margin of annual rates over the curve}, of technical provisions first.
    - `significant_maturity`: years of duration. `recovery_years` of the plan; None: the longest
      of the rules, `longest` before and `mature` at significant maturity.
    """

    since: str
    source: str
    margins: dict[str, float]
    significant_maturity: float
    longest: float
    mature: float
    recovery_years: float | None
