"""What an objective is: the worth of all paths' totals together, to be made as LARGE as possible.

An objective gives a value and the weight of every path and output, its derivative; engines
take weights, never objectives, so risk measures need no second kind of adjoint. `influence`
is each path's share of the value to first order: its spread gives the standard error.

Objectives add and scale: `Mean("x") + 0.5 * CVaR("x", 0.95)`. A cost is negated: `-Mean("cost")`.
A measure of risk with a negative weight is the same measure of minus its output with a positive
one: `-CVaR("cost", 0.9)` is minus the mean of the dearest tenth, not of the cheapest. A sign that
is taken back brings the first measure back.

An objective of one's own is one formula in `jax.numpy`; weights and errors follow from it::

    @dataclass(frozen=True)
    class Sharpe(snapo.Objective):
        outputs = ("profit",)
        def formula(self, totals):
            return jnp.mean(totals["profit"]) / jnp.std(totals["profit"])

A negative weight on it multiplies its numbers; `as_cost` says where something else is meant.
"""

import abc
import numbers
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import functional

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
    def tail(self) -> float:
        """The share of the paths that it is made of: 1, or that of a tail."""
        return 1.0

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

    @property
    def as_cost(self) -> "Objective":
        """The same measure of a cost, in place of it where the weight is negative: of a measure of
        risk the one that looks at the dear tail; itself for all others."""
        return self

    @property
    def as_gain(self) -> "Objective":
        """The inverse of `as_cost`."""
        return self

    def words(self) -> str:
        """The objective as a phrase, such as "mean of cash"."""
        return repr(self)

    def __str__(self) -> str:
        return self.words()

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

    def _times(self, over: Any, under: Any, words: str) -> "Weighted":
        if not all(isinstance(each, numbers.Real | np.bool_) for each in (over, under)):
            return NotImplemented
        factor = float(over) / float(under) if under else np.nan
        if not np.isfinite(factor):
            kind = type(self).__name__
            raise ValueError(f"{kind}: the factor is {words}; allowed is a finite number.")
        return Weighted((factor, self))


def _is(other: Any) -> bool:
    return isinstance(other, Objective)


@dataclass(frozen=True, init=False)
class Weighted(Objective):
    """A sum of factors times objectives.

    A term with a negative factor is a measure of a cost, one with a positive factor of a gain
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
        for (factor, _), found in zip(self.terms, weights):
            for name, weight in found.items():
                combined[name] = combined.get(name, 0.0) + factor * weight
        return combined

    def influence(self, totals: Totals) -> np.ndarray:
        return np.sum([factor * term.influence(totals) for factor, term in self.terms], axis=0)

    @property
    def as_cost(self) -> "Weighted":
        """Minus what a weight of -1 makes of it, term by term."""
        other = object.__new__(Weighted)
        terms = tuple((f, each.as_cost if f > 0 else each.as_gain) for f, each in self.terms)
        object.__setattr__(other, "terms", terms)
        return other

    def words(self) -> str:
        text = ""
        for factor, term in self.terms:
            size = f"{abs(factor):g} × " if abs(factor) != 1 else ""
            minus = "minus " if not text else "- "
            the = "the " if not text and not size and factor < 0 else ""
            sign = minus if factor < 0 else "+ " if text else ""
            text += f"{' ' if text else ''}{sign}{the}{size}{term.words()}"
        return text


def _sided(terms: Any) -> Iterator[tuple[float, Objective]]:
    """The terms without sums among them, measures of costs where the factor is negative."""
    for factor, term in terms:
        if isinstance(term, Weighted):
            yield from _sided((factor * own, each) for own, each in term.terms)
        elif factor:
            yield factor, term.as_cost if factor < 0 else term.as_gain
        else:
            yield factor, term
