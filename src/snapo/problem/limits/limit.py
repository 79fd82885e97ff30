"""Limits that hold on average, or with a probability: never exceeded is for the simulator."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..objective import Mean, Objective, Totals, Weighted


@dataclass(frozen=True)
class Limit:
    """A number made of all paths' totals that is kept on one side of a level; see `AtMost`."""

    of: Objective | str
    level: float
    sign: ClassVar[int] = 1
    words: ClassVar[str] = ""

    def __post_init__(self):
        kind, level = type(self).__name__, self.level
        if not isinstance(self.of, str | Objective):
            what = 'allowed is the name of an output or an objective, such as Probability("x", 0.0)'
            raise ValueError(f"{kind}: of is {self.of!r}; {what}.")
        plain = isinstance(level, int | float | np.number) and not isinstance(level, bool)
        if not (plain and np.isfinite(level)):
            raise ValueError(f"{kind}: level is {level!r}; allowed is a finite number.")
        _ = self.measure  # which refuses a utility of a cost

    @property
    def measure(self) -> Objective:
        """The number that is limited, as an objective: the mean of an output that is named.

        A measure of risk looks at the tail that breaks the limit: the dear one under `AtMost`.
        """
        of = Mean(self.of) if isinstance(self.of, str) else self.of
        return of.as_cost if self.sign > 0 else of

    @property
    def name(self) -> str:
        """The limit in words: "mean of unserved at most 0.05"."""
        return f"{self.measure.words()} {self.words} {self.level:g}"

    def excess(self, totals: Totals) -> float:
        """By how much the limit is not met; negative where it is."""
        return self.sign * (self.measure.value(totals) - self.level)


class AtMost(Limit):
    """The mean of an output, or any objective of it, is at most `level`.

    `AtMost("unserved", 0.05)`; with a probability `AtMost(Probability("shortfall", 0.0, width=1.0),
    0.01)`. Training finds its price (see `solve`, `limits`).

    >>> snapo.AtMost("unserved", 0.05).name
    'mean of unserved at most 0.05'
    """

    words = "at most"


class AtLeast(Limit):
    """The same from below: `AtLeast("filled", 0.98)`."""

    sign, words = -1, "at least"


def priced(objective: Objective, limits: Sequence[Limit], prices: Sequence[float]) -> Objective:
    """The objective less the price of every limit's measure, in the direction of its excess.

    Its derivatives are those of the best value within the limits; its value lacks the constant
    `price * level`.
    """
    if not limits:
        return objective
    terms = ((-each.sign * price, each.measure) for each, price in zip(limits, prices))
    return Weighted((1.0, objective), *terms)
