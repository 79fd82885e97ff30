"""Objectives: the value of all paths' totals together, to be maximised.

An objective returns a value and its derivative, the weight of every path and output; engines
take weights, never objectives, so that risk measures need no other adjoint. `influence`
is each path's share of the value to first order: its spread gives the standard error.

Objectives add and scale: `Mean("x") + 0.5 * CVaR("x", 0.95)`. A cost is negated: `-Mean("cost")`.
A risk measure with a negative weight is that of a cost: `-CVaR("cost", 0.9)` is minus the mean of
the most expensive tenth, not of the cheapest. Two minus signs give the original measure.

A user-defined objective is one formula in `jax.numpy`; weights and errors follow from it::

    @dataclass(frozen=True)
    class Sharpe(snapo.Objective):
        outputs = ("profit",)
        def formula(self, totals):
            return jnp.mean(totals["profit"]) / jnp.std(totals["profit"])

A negative weight multiplies its numbers, unless `as_cost` defines something else.

A comparison with a number is a constraint that holds on average or with a probability:
`Mean("unserved") <= 0.05`. A limit that must hold on every path belongs in the simulator.
"""

import abc
import numbers
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .. import functional

Totals = Mapping[str, np.ndarray]
Weights = dict[str, np.ndarray]


@dataclass(frozen=True)
class Objective(abc.ABC):
    """A statistic of path totals {name: [N]} that does not depend on the order of the paths.

    A subclass is a frozen dataclass with `outputs` and `formula`. Value, weights and influence
    follow from the formula; the objectives below have closed forms instead of a formula.
    """

    @property
    @abc.abstractmethod
    def outputs(self) -> Any:
        """The names of the outputs used, a tuple; may be a plain class attribute."""

    @property
    def linear(self) -> Any:
        """Whether the weights do not depend on the totals, which saves a forward sweep.

        It is declared, not detected: a subclass sets `linear = True`.
        """
        return False

    @property
    def tail(self) -> float:
        """The share of the paths that it uses: 1, or the share of a tail."""
        return 1.0

    @property
    def by_path(self) -> Any:
        """Whether it is a mean over paths of a function of one path's totals: its `influence`.

        Such an objective has an upper bound. A subclass declares this by `by_path = True`.
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
        """The weights used in training: the derivative wherever it exists."""
        return self.weights(totals)

    def influence(self, totals: Totals) -> np.ndarray:
        """[N] numbers whose mean is the value and whose spread gives its sampling error."""
        return functional.influence(self, self.used(totals))

    def certainty_equivalent(self, value: float) -> float | None:
        """The certainty equivalent; None if the objective does not declare one."""
        return None

    def used(self, totals: Totals) -> dict[str, np.ndarray]:
        """The totals of this objective's outputs in float64; an unknown name is an error."""
        for name in self.outputs:
            if name not in totals:
                raise KeyError(
                    f"{type(self).__name__}: there is no output {name!r}; the simulator returns "
                    f"{sorted(totals)}."
                )
        return {name: np.asarray(totals[name], np.float64) for name in self.outputs}

    @property
    def as_cost(self) -> "Objective":
        """The same measure for a cost, used if the weight is negative: a risk measure takes the
        tail of high values; every other objective is returned unchanged."""
        return self

    @property
    def as_gain(self) -> "Objective":
        """The inverse of `as_cost`."""
        return self

    def describe(self) -> str:
        """The objective as a phrase, such as "mean of cash"."""
        return repr(self)

    def __str__(self) -> str:
        return self.describe()

    # NumPy's numbers leave the multiplication to `__rmul__`.
    __array_ufunc__ = None

    def __add__(self, other: "Objective") -> "Weighted":
        return Weighted((1.0, self), (1.0, other)) if _is(other) else NotImplemented

    def __radd__(self, other: int) -> "Objective":
        """`sum` begins with 0."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __sub__(self, other: "Objective") -> "Weighted":
        return Weighted((1.0, self), (-1.0, other)) if _is(other) else NotImplemented

    def __mul__(self, factor: float) -> "Weighted":
        return self._times(factor, 1.0, f"{factor}")

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> "Weighted":
        return self._times(1.0, divisor, f"1 / {divisor}")

    def __neg__(self) -> "Weighted":
        return self * -1.0

    def __le__(self, level: float) -> "AtMost":
        return self._compared(AtMost, level)

    def __ge__(self, level: float) -> "AtLeast":
        return self._compared(AtLeast, level)

    def _compared(self, kind: Any, level: Any) -> Any:
        if not _number(level):
            name = type(self).__name__
            raise TypeError(f"{name}: compared with {level!r}; it must be a number.")
        return kind(self, level)

    def _times(self, over: Any, under: Any, text: str) -> "Weighted":
        if not all(isinstance(item, numbers.Real | np.bool_) for item in (over, under)):
            return NotImplemented
        factor = float(over) / float(under) if under else np.nan
        if not np.isfinite(factor):
            kind = type(self).__name__
            raise ValueError(f"{kind}: the factor is {text}; it must be a finite number.")
        return Weighted((factor, self))


def _number(other: Any) -> bool:
    return isinstance(other, numbers.Real) and not isinstance(other, bool)


def _is(other: Any) -> bool:
    return isinstance(other, Objective)


@dataclass(frozen=True, init=False)
class Weighted(Objective):
    """A sum of factors times objectives.

    A term with a negative factor measures a cost, one with a positive factor a gain
    (`Objective.as_cost`), and sums of sums are one sum.
    """

    terms: tuple[tuple[float, Objective], ...]

    def __init__(self, *terms: tuple[float, Objective]):
        object.__setattr__(self, "terms", tuple(_sided(terms)))

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, term in self.terms for name in term.outputs))

    @property
    def linear(self) -> bool:
        return all(term.linear for _, term in self.terms)

    @property
    def by_path(self) -> bool:
        return all(term.by_path for _, term in self.terms)

    @property
    def tail(self) -> float:
        return min((term.tail for _, term in self.terms), default=1.0)

    def value(self, totals: Totals) -> float:
        return sum(factor * term.value(totals) for factor, term in self.terms)

    def weights(self, totals: Totals) -> Weights:
        return self._combined([term.weights(totals) for _, term in self.terms])

    def climb(self, totals: Totals) -> Weights:
        return self._combined([term.climb(totals) for _, term in self.terms])

    def _combined(self, weights: list[Weights]) -> Weights:
        combined: Weights = {}
        for (factor, _), result in zip(self.terms, weights):
            for name, weight in result.items():
                combined[name] = combined.get(name, 0.0) + factor * weight
        return combined

    def influence(self, totals: Totals) -> np.ndarray:
        return np.sum([factor * term.influence(totals) for factor, term in self.terms], axis=0)

    @property
    def as_cost(self) -> "Weighted":
        """The same objective of a cost: every term with the sign of its weight reversed."""
        other = object.__new__(Weighted)
        terms = tuple((f, item.as_cost if f > 0 else item.as_gain) for f, item in self.terms)
        object.__setattr__(other, "terms", terms)
        return other

    def describe(self) -> str:
        text = ""
        for factor, term in self.terms:
            size = f"{abs(factor):g} × " if abs(factor) != 1 else ""
            minus = "minus " if not text else "- "
            the = "the " if not text and not size and factor < 0 else ""
            sign = minus if factor < 0 else "+ " if text else ""
            text += f"{' ' if text else ''}{sign}{the}{size}{term.describe()}"
        return text


def _sided(terms: Any) -> Iterator[tuple[float, Objective]]:
    """The terms of all sums in it; a term with a negative factor is a measure of costs."""
    for factor, term in terms:
        if isinstance(term, Weighted):
            yield from _sided((factor * local, item) for local, item in term.terms)
        elif factor:
            yield factor, term.as_cost if factor < 0 else term.as_gain
        else:
            yield factor, term


@dataclass(frozen=True)
class OneOutput(Objective):
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
        """Numbers whose mean is the value and whose spread gives its sampling error."""


class ByPath(OneOutput):
    """A mean of one number per path."""

    @property
    def by_path(self) -> bool:
        return True


@dataclass(frozen=True)
class Mean(ByPath):
    """The mean of an output over the paths."""

    @property
    def linear(self) -> bool:
        return True

    def describe(self) -> str:
        return f"mean of {self.output}"

    def _slope(self, x):
        return np.ones_like(x)

    def _influence(self, x):
        return x


@dataclass(frozen=True)
class Limit:
    """A limit on a statistic of all paths' totals; see `AtMost`."""

    of: Objective | str
    level: float
    sign: ClassVar[int] = 1
    relation: ClassVar[str] = ""

    def __post_init__(self):
        kind, level = type(self).__name__, self.level
        if not isinstance(self.of, str | Objective):
            allowed = 'the name of an output or an objective, such as Probability("x", 0.0)'
            raise ValueError(f"{kind}: of is {self.of!r}; it must be {allowed}.")
        if not (_number(level) and np.isfinite(level)):
            raise ValueError(f"{kind}: level is {level!r}; it must be a finite number.")
        _ = self.measure  # which refuses a utility of a cost

    @property
    def measure(self) -> Objective:
        """The limited statistic as an objective; if it is the name of an output, the mean. A risk
        measure uses the tail that violates the limit, which is that of high values for `AtMost`.
        """
        of = as_objective(self.of)
        return of.as_cost if self.sign > 0 else of

    @property
    def name(self) -> str:
        """The limit as text: "mean of unserved at most 0.05"."""
        return f"{self.measure.describe()} {self.relation} {self.level:g}"

    def __bool__(self) -> bool:
        raise TypeError(
            f"{self.name}: a constraint is neither true nor false; a chain of comparisons is two "
            "constraints, such as [0.1 <= x, x <= 0.2]."
        )

    def excess(self, totals: Totals) -> float:
        """The violation of the limit; negative where it is met."""
        return self.sign * (self.measure.value(totals) - self.level)


class AtMost(Limit):
    """A limit: the mean of an output, or any objective of it, is at most `level`. It is the same
    as `Mean("unserved") <= 0.05`, or for a probability `Probability("shortfall", 0.0, width=1.0)
    <= 0.01`. Training determines the price of the limit (see `constraints` of `solve`).

    >>> snapo.AtMost("unserved", 0.05).name
    'mean of unserved at most 0.05'
    >>> snapo.Mean("unserved") <= 0.05
    AtMost(of=Mean(output='unserved'), level=0.05)
    """

    relation = "at most"


class AtLeast(Limit):
    """A lower limit: `AtLeast("filled", 0.98)`, or `Mean("filled") >= 0.98`."""

    sign, relation = -1, "at least"


def as_objective(objective: Objective | str) -> Objective:
    """The mean of an output, if its name is passed; an objective is returned unchanged."""
    return Mean(objective) if isinstance(objective, str) else objective


def as_constraints(limits: Sequence[Limit] | Limit) -> tuple[Limit, ...]:
    """One limit or several, as a tuple."""
    return (limits,) if isinstance(limits, Limit) else tuple(limits)


def priced(objective: Objective, limits: Sequence[Limit], prices: Sequence[float]) -> Objective:
    """The objective minus the price of every limit's measure, in the direction of its excess.

    Its derivatives are those of the best value within the limits; its value omits the constant
    `price * level`.
    """
    if not limits:
        return objective
    pairs = zip(limits, prices)
    return Weighted((1.0, objective), *((-x.sign * price, x.measure) for x, price in pairs))
