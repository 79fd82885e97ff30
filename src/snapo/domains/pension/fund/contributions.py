"""Contribution rules, one object each: its keys, and its payment."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from snapo.problem.smooth import Constraints

from .terms import PlanTerms


class ContributionDue(NamedTuple):
    """A fund when a contribution is due: money, with the normal cost and salaries of the step.

    `step`: its length in years. `annuity`: years of level payments that have the value of a gap,
    None where the rule has a rolling share of it (see `recovery`).
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
    - `by_cost`: it begins with the normal cost, valued with a loading or a rate of salaries.
    - `responds`: it depends on the funding ratio, thus on decisions.
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
        return jnp.zeros_like(due.salaries)


class FixedContribution(ContributionRule):
    """`rate` times salaries."""

    kind, takes, by_cost = "fixed", ("rate",), False

    def amount(self, terms, due, smooth):
        return terms.rate * due.salaries


class NormalCost(ContributionRule):
    """The value of the step's accrual, independently of the funding ratio."""

    kind = "normal-cost"

    def amount(self, terms, due, smooth):
        return due.normal


class SpreadContribution(ContributionRule):
    """The normal cost and a yearly share of liability less assets; a surplus is spread too."""

    kind, takes, responds = "spread", ("spread_factor",), True

    def amount(self, terms, due, smooth):
        return due.normal + due.step * terms.spread_factor * (due.liability - due.assets)


class TargetContribution(ContributionRule):
    """The normal cost and the gap to a funding ratio: level payments with interest until a fixed
    end, or always the same share of the rest, without interest."""

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
