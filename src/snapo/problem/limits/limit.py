"""Limits that hold on average, or with a probability: never exceeded is for the simulator."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..objective import Mean, Objective, Probability, Totals, Weighted


@dataclass(frozen=True)
class Limit:
    """A number made of all paths' totals that is kept on one side of a level; see `AtMost`."""

    of: Objective | str
    level: float
    sign: ClassVar[int] = 1
    words: ClassVar[str] = ""

    def __post_init__(self):
        if not np.isfinite(self.level):
            raise ValueError(f"{type(self).__name__}: level is {self.level}; it must be finite.")

    @property
    def measure(self) -> Objective:
        """The number that is limited, as an objective: the mean of an output that is named."""
        return Mean(self.of) if isinstance(self.of, str) else self.of

    @property
    def name(self) -> str:
        """The limit in words: "mean of unserved at most 0.05"."""
        measure = self.measure
        words = {Mean: "mean of ", Probability: "probability of "}.get(type(measure))
        what = words + " and ".join(measure.outputs) if words else repr(measure)
        if isinstance(measure, Probability):
            what += f" above {measure.threshold:g}"
        return f"{what} {self.words} {self.level:g}"

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
