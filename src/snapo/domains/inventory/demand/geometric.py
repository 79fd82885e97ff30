"""`[demand]` of kind "geometric"."""

from typing import Literal

import jax.numpy as jnp

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable, TableContext

from .base import MEAN, register
from .counts import ROOM, CountDemand, count_mean, most_of


class GeometricTable(CaseTable):
    """`[demand]` of kind "geometric"."""

    kind: Literal["geometric"]
    mean: CaseInput = count_mean()


@register
class GeometricDemand(CountDemand):
    """p(k) = (1 - q) q^k with q = m / (1 + m), m the mean of the period."""

    kind = "geometric"
    table = GeometricTable
    mean: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: GeometricTable, maximum: float):
        mean = ROOM * maximum * table.mean.values[0]
        return cls(most_of("nbinom", 1, 1 / (1 + mean)), table.mean)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - (k + 1) * jnp.log1p(mean)

    def deviation(self, parameters, factors):
        mean = parameters[MEAN] * factors
        return (mean * (1 + mean)) ** 0.5

    def describe(self) -> str:
        return f"geometric, mean {self.mean.values[0]:g}"
