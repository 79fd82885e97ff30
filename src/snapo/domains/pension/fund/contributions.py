"""Contribution rules: every rule is an object with its keys and its payment.

Level payments close a gap to the target as an annuity with the interest of the valuation. From time
0 on, time is divided into recovery periods of whole steps. At each step the current gap is divided
by the value of 1 a year until the end of the period, at the forward rates of today's valuation. If
assets and liability earn these rates, payments are level and the gap is closed at the end of the
period.
"""

from typing import ClassVar, NamedTuple

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import xp
from snapo.problem.smooth import Constraints

from .terms import PlanTerms


class ContributionDue(NamedTuple):
    """A fund when a contribution is due: its assets and liability, and the salaries and the normal
    cost of the step, in money.

    `step`: its length in years. `annuity`: the gap divided by this number is the level yearly
    payment that closes it; None if the rule pays a rolling share of the gap (see `recovery`).
    """

    assets: Array
    liability: Array
    salaries: Array
    normal: Array
    step: float
    annuity: Array | None = None


class ContributionRule:
    """One kind of `[plan.contribution]`.

    - `takes`: its keys in addition to those of the normal cost and of the limits.
    - `by_cost`: whether it begins with the normal cost, valued with a loading or as a rate of
      salaries.
    - `responds`: whether it depends on the funding ratio, and therefore on decisions.
    """

    kind: ClassVar[str]
    takes: ClassVar[tuple[str, ...]] = ()
    by_cost: ClassVar[bool] = True
    responds: ClassVar[bool] = False

    def amount(self, terms: PlanTerms, due: ContributionDue, smooth: Constraints) -> Array:
        """The payment of this step before its limits."""
        raise NotImplementedError


class NoContribution(ContributionRule):
    """No contributions, and no limits to them."""

    kind, by_cost = "none", False

    def amount(self, terms, due, smooth):
        return xp.zeros_like(due.salaries)


class FixedContribution(ContributionRule):
    """`rate` times salaries."""

    kind, takes, by_cost = "fixed", ("rate",), False

    def amount(self, terms, due, smooth):
        return terms.rate * due.salaries


class NormalCost(ContributionRule):
    """The value of the step's accrual, whatever the funding ratio is."""

    kind = "normal-cost"

    def amount(self, terms, due, smooth):
        return due.normal


class SpreadContribution(ContributionRule):
    """The normal cost plus a yearly share of liability minus assets; a surplus reduces it."""

    kind, takes, responds = "spread", ("spread_factor",), True

    def amount(self, terms, due, smooth):
        return due.normal + due.step * terms.spread_factor * (due.liability - due.assets)


class TargetContribution(ContributionRule):
    """The normal cost plus payments that close the gap to a funding ratio: level payments with
    interest until a fixed end, or always the same share of the remaining gap, without interest."""

    kind, takes, responds = "target", ("target_ratio", "recovery", "recovery_years"), True

    def amount(self, terms, due, smooth):
        missing = terms.target * due.liability - due.assets
        missing = smooth.positive_part(missing, due.liability)
        years = terms.recovery_years if due.annuity is None else due.annuity
        return due.normal + due.step * missing / years


CONTRIBUTIONS: dict[str, ContributionRule] = {
    rule.kind: rule
    for rule in (
        NoContribution(),
        FixedContribution(),
        NormalCost(),
        SpreadContribution(),
        TargetContribution(),
    )
}
