"""Rules of indexation: every rule is an object with the keys that it takes and the increase that it
grants."""

from typing import ClassVar

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import xp
from snapo.problem.smooth import Constraints

from .terms import PlanTerms

RATIO, GROWTH = 0.1, 0.01  # scales of corners in funding ratios and in yearly price growth


class IncreaseRule:
    """One kind of `[plan.indexation]`; `takes`: its additional keys."""

    kind: ClassVar[str]
    takes: ClassVar[tuple[str, ...]] = ()

    def granted(self, terms: PlanTerms, ratio: Array, growth: Array, smooth: Constraints) -> Array:
        """The increase at a policy funding ratio, after prices grew by `growth`."""
        raise NotImplementedError


class NoIncrease(IncreaseRule):
    """No increases."""

    kind = "none"

    def granted(self, terms, ratio, growth, smooth):
        return xp.zeros_like(ratio)


class FixedIncrease(NoIncrease):
    """A fixed rate, which the payments already contain: nothing is granted in addition."""

    kind, takes = "fixed", ("rate",)


class Full(IncreaseRule):
    """The growth of prices, negative under deflation."""

    kind = "full"

    def granted(self, terms, ratio, growth, smooth):
        return growth


class Capped(IncreaseRule):
    """The growth of prices between a floor and a cap."""

    kind, takes = "capped", ("cap", "floor")

    def granted(self, terms, ratio, growth, smooth):
        return smooth.clip(growth, terms.floor, terms.cap, GROWTH)


class Conditional(Capped):
    """The capped growth times a ramp of the policy funding ratio, from 0 to 1."""

    kind, takes = "conditional", ("cap", "floor", "lower_ratio", "upper_ratio")

    def granted(self, terms, ratio, growth, smooth):
        # Equal ratios make the ramp a jump; a width of a millionth keeps it finite.
        width = xp.maximum(terms.upper - terms.lower, 1e-6)
        share = smooth.clip((ratio - terms.lower) / width, 0.0, 1.0, RATIO)
        return super().granted(terms, ratio, growth, smooth) * share


INCREASES: dict[str, IncreaseRule] = {
    rule.kind: rule for rule in (NoIncrease(), FixedIncrease(), Full(), Capped(), Conditional())
}
