"""The interface of all kinds of demand, and their list.

Demand of a period is a function of one standard normal and of parameters. It has derivatives with
respect to the parameters in exact and in smooth simulation. Periods differ in a factor that
multiplies the mean.
"""

import abc
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import POSITIVE, Quantity, Range
from snapo.case.table import CaseTable, TableContext
from snapo.problem.form import Use
from snapo.problem.record import Input, TreeRecord
from snapo.problem.record.arrays import Array, Float

MEAN, DEVIATION = "demand_mean", "demand_deviation"

Parameters = Mapping[str, Any]


def mean_key(range: Range = POSITIVE, default: Any = ...) -> Any:
    """The key `mean` of a table: the mean of a period whose factor is 1."""
    quantity = Quantity("1", range, "demand", name=MEAN)
    return quantity("mean demand of a period", default)


def deviation_key(note: str = "", default: Any = ...) -> Any:
    """The key `deviation` of a table, for a period whose factor is 1; `note`: text added to its
    range."""
    quantity = Quantity("1", POSITIVE._replace(note=note), "demand", name=DEVIATION)
    return quantity("standard deviation of the demand of a period", default)


class Demand(TreeRecord):
    """The demand of each period: static fields, arrays, and its parameters.

    **Class attributes:** `kind`, the word in `[demand]`; `table`, its keys; `integer`, whether
    demand is in whole units.
    """

    kind: ClassVar[str]
    table: ClassVar[type[CaseTable]]
    integer: ClassVar[bool] = False

    @classmethod
    @abc.abstractmethod
    def read(cls, section: TableContext, table: Any, maximum: float) -> Self:
        """Makes the demand from its table, whose numbers have units; `maximum`: the largest factor
        of a period."""

    def inputs(self) -> tuple[CaseInput, ...]:
        """The parameters as differentiable inputs."""
        return tuple(x for x in vars(self).values() if isinstance(x, CaseInput))

    def names(self) -> tuple[str, ...]:
        """The names of the parameters, both in a case and in a simulator."""
        return tuple(x.name for x in vars(self).values() if isinstance(x, CaseInput | Use))

    @abc.abstractmethod
    def prepare(self, parameters: Parameters, factors: Float[Array, " T"]) -> Any:
        """The schedule of demand [T, …], which is computed once for all paths."""

    @abc.abstractmethod
    def draw(self, now: Any, normal: Float[Array, ""], spread: bool) -> Float[Array, ""]:
        """Demand of the period `now`; `spread`: whether whole demand is spread over an interval of
        one unit."""

    @abc.abstractmethod
    def deviation(self, parameters: Parameters, factors: Any) -> Any:
        """The standard deviations of periods with these factors, in the shape of `factors`."""

    @abc.abstractmethod
    def describe(self) -> str:
        """A short description: "Poisson, mean 5"."""

    def probabilities(self, parameters: Parameters, factor: float = 1.0) -> Float[np.ndarray, " n"]:
        """The probabilities of demand 0, 1, …; an upper tail of probability 1e-8 is omitted."""
        raise NotImplementedError(f"demand {self.kind!r} is not in whole units.")

    def integral(self) -> bool:
        """Whether every demand is a whole number."""
        return self.integer

    def in_pieces(self) -> bool:
        """Whether demand, or its history, is in whole units; orders are then whole by default."""
        return self.integral()

    def values(self) -> dict[str, float]:
        """The parameters in the case."""
        return {item.name: float(item.values[0]) for item in self.inputs()}


KINDS: dict[str, type[Demand]] = {}


def register(demand: type[Demand]) -> type[Demand]:
    """Registers a demand under its `kind`; an incomplete class is refused."""
    missing = sorted(getattr(demand, "__abstractmethods__", ()))
    missing += [name for name in ("kind", "table") if not hasattr(demand, name)]
    if missing:
        raise TypeError(f"demand {demand.__name__} has no {', '.join(missing)}")
    if demand.kind in KINDS:
        raise TypeError(f"demand {demand.__name__}: {demand.kind!r} is registered already")
    KINDS[demand.kind] = demand
    return demand


def as_input(numbers: CaseInput) -> Input:
    """Numbers of a case as an input; a single number remains a scalar."""
    made = numbers.input()
    return made if numbers.labels != ("",) else replace(made, value=made.value.reshape(()))
