"""`[demand]` of kind "poisson"."""

from typing import Literal

import jax.numpy as jnp
from jax.scipy.special import gammaln

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable, TableContext

from .base import MEAN, register
from .counts import ROOM, CountDemand, count_mean, most_of


class PoissonTable(CaseTable):
    """`[demand]` of kind "poisson"."""

    kind: Literal["poisson"]
    mean: CaseInput = count_mean()


@register
class PoissonDemand(CountDemand):
    """p(k) = e^-m m^k / k!, m the mean of the period."""

    kind = "poisson"
    table = PoissonTable
    mean: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: PoissonTable, maximum: float):
        mean = ROOM * maximum * table.mean.values[0]
        return cls(most_of("poisson", mean), table.mean)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - mean - gammaln(k + 1.0)

    def deviation(self, parameters, factors):
        return (parameters[MEAN] * factors) ** 0.5

    def describe(self) -> str:
        return f"Poisson, mean {self.mean.values[0]:g}"
