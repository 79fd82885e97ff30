"""Objectives in closed form: measures of risk, utilities, probabilities."""

import abc
from dataclasses import dataclass

import numpy as np

from .base import ByPath, Objective, OneOutput, Totals, Weights


class _Risk(OneOutput):
    """A measure of risk; for a cost it takes the other tail."""

    @property
    def as_cost(self) -> "OfCost":
        return OfCost(self)

    def describe(self) -> str:
        return self._words(cost=False)

    @abc.abstractmethod
    def _words(self, cost: bool) -> str:
        """The measure of a gain or of a cost, as a phrase."""


@dataclass(frozen=True)
class OfCost(Objective):
    """Minus a risk measure of minus its output, a cost, so that paths with high costs count most.

    >>> dear = snapo.AtMost(snapo.CVaR("cost", 0.9), 90.0).measure
    >>> round(float(dear.value({"cost": np.arange(100.0)})), 6)  # the mean of the largest ten
    94.5
    """

    measure: _Risk

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.measure.outputs

    @property
    def tail(self) -> float:
        return self.measure.tail

    @property
    def as_gain(self) -> _Risk:
        return self.measure

    def value(self, totals: Totals) -> float:
        return -self.measure.value(self._opposite(totals))

    def weights(self, totals: Totals) -> Weights:
        return self.measure.weights(self._opposite(totals))

    def influence(self, totals: Totals) -> np.ndarray:
        return -self.measure.influence(self._opposite(totals))

    def describe(self) -> str:
        return self.measure._words(cost=True)

    def _opposite(self, totals: Totals) -> Totals:
        return {name: -total for name, total in self.measure.used(totals).items()}


@dataclass(frozen=True)
class CVaR(_Risk):
    """The mean of the worst (smallest) 1 - level of the paths (Rockafellar and Uryasev 2000).

    Tail measures on few paths are biased: keep at least 50 paths in the tail.

    >>> worst = snapo.CVaR("cash", 0.9)
    >>> round(float(worst.value({"cash": np.arange(100.0)})), 6)  # the mean of the smallest ten
    4.5
    """

    level: float = 0.95

    def __post_init__(self):
        if not 0 < self.level < 1:
            raise ValueError(f"CVaR: level is {self.level}; it must lie between 0 and 1.")

    @property
    def tail(self) -> float:
        return 1 - self.level

    def _words(self, cost):
        tail = "largest" if cost else "smallest"
        return f"mean of the {tail} {100 * (1 - self.level):.4g} % of {self.output}"

    def _slope(self, x):
        # The path on the edge of the tail counts in part, so that the weights sum to one.
        tail = (1 - self.level) * x.size
        rank = np.empty(x.size)
        rank[np.argsort(x, kind="stable")] = np.arange(x.size)
        return np.clip(tail - rank, 0, 1) * x.size / tail

    def _influence(self, x):
        tail = (1 - self.level) * x.size
        edge = np.sort(x)[min(int(tail), x.size - 1)]
        return edge + np.minimum(x - edge, 0) / (1 - self.level)


@dataclass(frozen=True)
class MeanVariance(_Risk):
    """mean - risk_aversion / 2 * variance; of a cost, mean + risk_aversion / 2 * variance."""

    risk_aversion: float = 1.0

    def _words(self, cost):
        of = f"{'the cost ' * cost}{self.output}"
        return f"mean-variance of {of} (aversion {self.risk_aversion:g})"

    def _slope(self, x):
        return 1 - self.risk_aversion * (x - x.mean())

    def _influence(self, x):
        return x - self.risk_aversion / 2 * (x - x.mean()) ** 2


@dataclass(frozen=True)
class Entropic(_Risk):
    """-log(mean(exp(-a x))) / a, the certainty equivalent of exponential utility, a > 0."""

    risk_aversion: float = 1.0

    def _words(self, cost):
        of = f"{'the cost ' * cost}{self.output}"
        return f"entropic mean of {of} (aversion {self.risk_aversion:g})"

    def _slope(self, x):
        tilt = np.exp(-self.risk_aversion * (x - x.min()))
        return tilt / tilt.mean()

    def _influence(self, x):
        tilt = self._slope(x)
        mean = np.exp(-self.risk_aversion * (x - x.min())).mean()
        level = x.min() - np.log(mean) / self.risk_aversion
        return level - (tilt - 1) / self.risk_aversion


@dataclass(frozen=True)
class ExpectedUtility(ByPath):
    """Mean utility of the total, such as `CRRA(5.0)`.

    Ruin is an outcome with the worst utility: with one such path the value is minus infinity and
    has no derivative. Training moves away from ruin: such a path has the weight of the path with
    the largest marginal utility.
    """

    utility: "CRRA"

    @property
    def as_cost(self) -> Objective:
        raise ValueError(
            f"ExpectedUtility of {self.output}: a utility must be of a quantity that is "
            "maximised, so its weight must be positive and it cannot have an upper limit. For a "
            "cost, let the simulator return "
            f"-{self.output} as an output, and write the utility of that."
        )

    def describe(self) -> str:
        return f"mean utility of {self.output}, {self.utility}"

    def climb(self, totals: Totals) -> Weights:
        (weight,) = self.weights(totals).values()
        alive = np.isfinite(weight)
        maximum = weight[alive].max() if alive.any() else 1 / weight.size
        return {self.output: np.where(alive, weight, maximum)}

    def certainty_equivalent(self, value: float) -> float | None:
        certainty_equivalent = self.utility.certainty_equivalent(value)
        return certainty_equivalent if np.isfinite(certainty_equivalent) else None

    def _slope(self, x):
        return self.utility.slope(x)

    def _influence(self, x):
        return self.utility(x)


@dataclass(frozen=True)
class CRRA:
    """Utility W^(1 - risk_aversion) / (1 - risk_aversion) of W = wealth + x. For a risk aversion of
    1 it is log(W); if W <= 0 it is minus infinity.

    >>> snapo.CRRA(2.0)(np.array([1.0, 2.0])).tolist()
    [-1.0, -0.5]
    """

    risk_aversion: float
    wealth: float = 0.0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        x = x + self.wealth
        positive = np.where(x > 0, x, 1.0)
        if self.risk_aversion == 1:
            utility = np.log(positive)
        else:
            utility = positive ** (1 - self.risk_aversion) / (1 - self.risk_aversion)
        return np.where(x > 0, utility, -np.inf)

    def slope(self, x: np.ndarray) -> np.ndarray:
        x = x + self.wealth
        return np.where(x > 0, np.where(x > 0, x, 1.0) ** -self.risk_aversion, np.nan)

    def certainty_equivalent(self, utility: float) -> float:
        """The certainty equivalent of this utility; infinite if there is none."""
        if self.risk_aversion == 1:
            return float(np.exp(utility)) - self.wealth
        power = (1 - self.risk_aversion) * utility
        if power <= 0:
            return np.inf if self.risk_aversion > 1 else -self.wealth
        return float(power ** (1 / (1 - self.risk_aversion))) - self.wealth


@dataclass(frozen=True)
class Target(ByPath):
    """Minus the mean squared distance from a target: -mean((x - target)^2)."""

    target: float = 0.0

    def describe(self) -> str:
        return f"minus the mean squared distance of {self.output} from {self.target:g}"

    def _slope(self, x):
        return -2 * (x - self.target)

    def _influence(self, x):
        return -((x - self.target) ** 2)


@dataclass(frozen=True)
class Probability(ByPath):
    """The probability that x > threshold; its weights smooth the step over `width` (in x's unit).

    The value is the exact frequency. The pathwise derivative of a step is zero, so the weights
    are those of a logistic step of this width.

    >>> funded = snapo.Probability("ratio", threshold=1.0)
    >>> float(funded.value({"ratio": np.array([0.9, 1.1, 1.2, 1.3])}))
    0.75
    """

    threshold: float = 0.0
    width: float = 1.0

    def describe(self) -> str:
        return f"probability of {self.output} above {self.threshold:g}"

    def _slope(self, x):
        z = np.abs(x - self.threshold) / self.width
        return np.exp(-z) / (1 + np.exp(-z)) ** 2 / self.width

    def _influence(self, x):
        return (x > self.threshold).astype(float)
