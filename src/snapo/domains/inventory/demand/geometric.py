"""`[demand]` of kind "geometric"."""

from typing import Literal

import jax.numpy as jnp
from pydantic import Field
from scipy import stats

from snapo.case.table import CaseTable, TableContext

from .base import MEAN, mean_given, register
from .counts import ROOM, CountDemand, most_of
from .sizes import MEANS, MeanSize


class GeometricTable(CaseTable):
    """`[demand]` of kind "geometric"."""

    kind: Literal["geometric"]
    mean: MeanSize = Field(description=MEANS)


@register
class GeometricDemand(CountDemand):
    """p(k) = (1 - q) q^k with q = m / (1 + m), m the mean of the period."""

    kind = "geometric"
    table = GeometricTable
    maximum: int
    mean: float
    unit: str

    @classmethod
    def read(cls, section: TableContext, table: GeometricTable, unit: str, maximum: float):
        mean = ROOM * maximum * table.mean
        return cls(most_of(stats.nbinom(1, 1 / (1 + mean)).ppf), table.mean, unit)

    def inputs(self):
        return (mean_given(self.mean, self.unit),)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - (k + 1) * jnp.log1p(mean)

    def deviation(self, parameters, factors):
        mean = parameters[MEAN] * factors
        return (mean * (1 + mean)) ** 0.5

    def describe(self) -> str:
        return f"geometric, mean {self.mean:g}"
