"""Objectives: the worth of all paths' totals together, always to be made as LARGE as possible.

An objective gives a value and the weight of every path and output, its derivative; engines
take weights, never objectives, so risk measures need no second kind of adjoint. `influence`
is each path's share of the value to first order: its spread gives the standard error. For a
cost, negate: `-Mean("cost")`. Objectives add and scale: `Mean("x") + 0.5 * CVaR("x", 0.95)`.

An objective of one's own is one formula in `jax.numpy`; weights and errors follow from it::

    @dataclass(frozen=True)
    class Sharpe(snapo.Objective):
        outputs = ("profit",)
        def formula(self, totals):
            return jnp.mean(totals["profit"]) / jnp.std(totals["profit"])
"""

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import functional

Totals = Mapping[str, np.ndarray]
Weights = dict[str, np.ndarray]


@dataclass(frozen=True)
class Objective(abc.ABC):
    """A number made from path totals {name: [N]}, the same in whatever order the paths are.

    A subclass is a frozen dataclass with `outputs` and `formula`. Value, weights and influence
    follow from the formula; the objectives below have closed forms in place of it.
    """

    @property
    @abc.abstractmethod
    def outputs(self) -> Any:
        """The names of the outputs used, a tuple; a plain class attribute will do."""

    @property
    def linear(self) -> Any:
        """Whether the weights do not depend on the totals, which saves a forward sweep.

        It is declared, not detected: a subclass says `linear = True`.
        """
        return False

    @property
    def by_path(self) -> Any:
        """Whether it is a mean of numbers, each made of one path's totals alone: its `influence`.

        Such an objective has a bound from above. It is declared: a subclass says `by_path = True`.
        """
        return False

    def formula(self, totals: Mapping[str, Any]) -> Any:
        """The objective in `jax.numpy`, of the totals {name: [N]} of its outputs in float64."""
        raise NotImplementedError(
            f"{type(self).__name__}: write formula(self, totals), one number in jax.numpy."
        )

    def value(self, totals: Totals) -> float:
        """The objective on these paths."""
        return functional.value(self, self.used(totals))

    def weights(self, totals: Totals) -> Weights:
        """Its derivative with respect to every path total used: {name: [N]}."""
        return functional.weights(self, self.used(totals))

    def climb(self, totals: Totals) -> Weights:
        """The weights that training follows: its derivative wherever there is one."""
        return self.weights(totals)

    def influence(self, totals: Totals) -> np.ndarray:
        """[N]: numbers whose mean is the value and whose spread is its sampling error."""
        return functional.influence(self, self.used(totals))

    def sure(self, value: float) -> float | None:
        """The total that is worth as much when it is sure; None where nothing says so."""
        return None

    def used(self, totals: Totals) -> dict[str, np.ndarray]:
        """The totals of this objective's outputs in float64; an unknown name is an error."""
        for name in self.outputs:
            if name not in totals:
                raise KeyError(
                    f"{type(self).__name__}: no output {name!r}; the simulator gives "
                    f"{sorted(totals)}."
                )
        return {name: np.asarray(totals[name], np.float64) for name in self.outputs}

    def __add__(self, other: "Objective") -> "Weighted":
        return Weighted((1.0, self), (1.0, other))

    def __sub__(self, other: "Objective") -> "Weighted":
        return Weighted((1.0, self), (-1.0, other))

    def __mul__(self, factor: float) -> "Weighted":
        return Weighted((float(factor), self))

    __rmul__ = __mul__

    def __neg__(self) -> "Weighted":
        return self * -1.0


@dataclass(frozen=True)
class _OneOutput(Objective):
    """An objective of one output's totals x in closed form, by its slope and influence."""

    output: str

    @property
    def outputs(self) -> tuple[str, ...]:
        return (self.output,)

    def value(self, totals: Totals) -> float:
        return float(np.mean(self.influence(totals)))

    def weights(self, totals: Totals) -> Weights:
        x = self.used(totals)[self.output]
        return {self.output: self._slope(x) / x.size}

    def influence(self, totals: Totals) -> np.ndarray:
        return self._influence(self.used(totals)[self.output])

    @abc.abstractmethod
    def _slope(self, x: np.ndarray) -> np.ndarray:
        """N times d value / d x."""

    @abc.abstractmethod
    def _influence(self, x: np.ndarray) -> np.ndarray:
        """Numbers whose mean is the value and whose spread is its sampling error."""


class _ByPath(_OneOutput):
    """A mean of each path's own number."""

    @property
    def by_path(self) -> bool:
        return True


@dataclass(frozen=True)
class Mean(_ByPath):
    """The mean."""

    @property
    def linear(self) -> bool:
        return True

    def _slope(self, x):
        return np.ones_like(x)

    def _influence(self, x):
        return x


@dataclass(frozen=True)
class CVaR(_OneOutput):
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
class MeanVariance(_OneOutput):
    """mean - aversion / 2 * variance."""

    aversion: float = 1.0

    def _slope(self, x):
        return 1 - self.aversion * (x - x.mean())

    def _influence(self, x):
        return x - self.aversion / 2 * (x - x.mean()) ** 2


@dataclass(frozen=True)
class Entropic(_OneOutput):
    """-log(mean(exp(-a x))) / a, the certainty equivalent of exponential utility, a > 0."""

    aversion: float = 1.0

    def _slope(self, x):
        tilt = np.exp(-self.aversion * (x - x.min()))
        return tilt / tilt.mean()

    def _influence(self, x):
        tilt = self._slope(x)
        level = x.min() - np.log(np.exp(-self.aversion * (x - x.min())).mean()) / self.aversion
        return level - (tilt - 1) / self.aversion


@dataclass(frozen=True)
class ExpectedUtility(_ByPath):
    """Mean utility of the total, such as `CRRA(5.0)`.

    Ruin is an outcome with the worst utility: with one path of it the value is minus infinity and
    has no derivative. Training leads away from it: a path of ruin has the weight of the path for
    which a unit more is worth most.
    """

    utility: "CRRA"

    def climb(self, totals: Totals) -> Weights:
        (weight,) = self.weights(totals).values()
        alive = np.isfinite(weight)
        most = weight[alive].max() if alive.any() else 1 / weight.size
        return {self.output: np.where(alive, weight, most)}

    def sure(self, value: float) -> float | None:
        found = self.utility.certainty_equivalent(value)
        return found if np.isfinite(found) else None

    def _slope(self, x):
        return self.utility.slope(x)

    def _influence(self, x):
        return self.utility(x)


@dataclass(frozen=True)
class CRRA:
    """Utility W^(1 - aversion) / (1 - aversion) of W = wealth + x, the logarithm at aversion 1;
    minus infinity where W <= 0.

    >>> snapo.CRRA(2.0)(np.array([1.0, 2.0])).tolist()
    [-1.0, -0.5]
    """

    aversion: float
    wealth: float = 0.0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        x = x + self.wealth
        positive = np.where(x > 0, x, 1.0)
        if self.aversion == 1:
            utility = np.log(positive)
        else:
            utility = positive ** (1 - self.aversion) / (1 - self.aversion)
        return np.where(x > 0, utility, -np.inf)

    def slope(self, x: np.ndarray) -> np.ndarray:
        x = x + self.wealth
        return np.where(x > 0, np.where(x > 0, x, 1.0) ** -self.aversion, np.nan)

    def certainty_equivalent(self, utility: float) -> float:
        """The sure x of this utility; infinite where no x has as much."""
        if self.aversion == 1:
            return float(np.exp(utility)) - self.wealth
        power = (1 - self.aversion) * utility
        if power <= 0:
            return np.inf if self.aversion > 1 else -self.wealth
        return float(power ** (1 / (1 - self.aversion))) - self.wealth


@dataclass(frozen=True)
class Target(_ByPath):
    """Minus the mean squared distance from a target: -mean((x - target)^2)."""

    target: float = 0.0

    def _slope(self, x):
        return -2 * (x - self.target)

    def _influence(self, x):
        return -((x - self.target) ** 2)


@dataclass(frozen=True)
class Probability(_ByPath):
    """The probability that x > threshold; its weights round the step over `width` (in x's unit).

    The value is the exact frequency. The pathwise derivative of a step is zero, so the weights
    are those of a logistic step of this width.

    >>> funded = snapo.Probability("ratio", threshold=1.0)
    >>> float(funded.value({"ratio": np.array([0.9, 1.1, 1.2, 1.3])}))
    0.75
    """

    threshold: float = 0.0
    width: float = 1.0

    def _slope(self, x):
        z = np.abs(x - self.threshold) / self.width
        return np.exp(-z) / (1 + np.exp(-z)) ** 2 / self.width

    def _influence(self, x):
        return (x > self.threshold).astype(float)


@dataclass(frozen=True, init=False)
class Weighted(Objective):
    """A sum of factors times objectives."""

    terms: tuple[tuple[float, Objective], ...]

    def __init__(self, *terms: tuple[float, Objective]):
        object.__setattr__(self, "terms", terms)

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, term in self.terms for name in term.outputs))

    @property
    def linear(self) -> bool:
        return all(term.linear for _, term in self.terms)

    @property
    def by_path(self) -> bool:
        return all(term.by_path for _, term in self.terms)

    def value(self, totals: Totals) -> float:
        return sum(factor * term.value(totals) for factor, term in self.terms)

    def weights(self, totals: Totals) -> Weights:
        return self._combined([term.weights(totals) for _, term in self.terms])

    def climb(self, totals: Totals) -> Weights:
        return self._combined([term.climb(totals) for _, term in self.terms])

    def _combined(self, weights: list[Weights]) -> Weights:
        combined: Weights = {}
        for (factor, _), found in zip(self.terms, weights):
            for name, weight in found.items():
                combined[name] = combined.get(name, 0.0) + factor * weight
        return combined

    def influence(self, totals: Totals) -> np.ndarray:
        return np.sum([factor * term.influence(totals) for factor, term in self.terms], axis=0)
