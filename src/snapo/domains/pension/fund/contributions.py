"""Contribution rules: every rule is an object with its keys and its payment.

Level payments close a gap to the target as an annuity with the interest of the valuation. From time
0 on, time is divided into recovery periods of whole steps. At each step the current gap is divided
by the value of 1 a year until the end of the period, at the forward rates of today's valuation. If
assets and liability earn these rates, payments are level and the gap is closed at the end of the
period.
"""

from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp
from snapo.problem.smooth import Constraints

from ..market.curve import log_bond
from ..records.case import PensionModel
from ..records.inputs import use
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


def log_discount(case: PensionModel, inputs: dict[str, Any], years: np.ndarray) -> Array:
    """The logarithms [n] of the discount factors of money at times `years`, on the basis of the
    valuation."""
    basis = case.liability
    added = 0.0 if basis.basis == "risk-free" else -use(inputs, basis.rate) * years
    if basis.basis != "fixed":
        return log_bond(case.curve, inputs, years) + added
    if basis.future_indexation == "full":  # a real rate
        added = added + log_bond(case.inflation.break_even, inputs, years)
    return xp.asarray(added)


def annuity(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " T"] | None:
    """The value at each step of 1 a year until the end of the recovery period, [T]; None without
    level payments."""
    period = case.plan.contribution.level_steps
    if period is None:
        return None
    now = np.arange(case.steps)
    end = now + period - now % period
    discount = xp.exp(log_discount(case, inputs, np.arange(end[-1] + 1) * case.step))
    paid = xp.concatenate([xp.zeros(1), xp.cumsum(discount)])
    first = 0 if case.plan.timing == "advance" else 1
    return case.step * (paid[end + first] - paid[now + first]) / discount[now]
