"""`[demand]` of kind "poisson"."""

from typing import Literal

import jax.numpy as jnp
from jax.scipy.special import gammaln
from pydantic import Field
from scipy import stats

from snapo.case.table import CaseTable, TableContext

from .base import MEAN, mean_given, register
from .counts import ROOM, CountDemand, most_of
from .sizes import MEANS, MeanSize


class PoissonTable(CaseTable):
    """`[demand]` of kind "poisson"."""

    kind: Literal["poisson"]
    mean: MeanSize = Field(description=MEANS)


@register
class PoissonDemand(CountDemand):
    """p(k) = e^-m m^k / k!, m the mean of the period."""

    kind = "poisson"
    table = PoissonTable
    maximum: int
    mean: float
    unit: str

    @classmethod
    def read(cls, section: TableContext, table: PoissonTable, unit: str, maximum: float):
        return cls(most_of(stats.poisson(ROOM * maximum * table.mean).ppf), table.mean, unit)

    def inputs(self):
        return (mean_given(self.mean, self.unit),)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - mean - gammaln(k + 1.0)

    def deviation(self, parameters, factors):
        return (parameters[MEAN] * factors) ** 0.5

    def describe(self) -> str:
        return f"Poisson, mean {self.mean:g}"
