"""`[demand]` of kind "negative-binomial"."""

from typing import Literal

import jax.numpy as jnp
from jax.scipy.special import gammaln
from pydantic import Field
from scipy import stats

from snapo.case.table import CaseTable, Positive, TableContext

from .base import DEVIATION, MEAN, deviation_given, mean_given, register
from .counts import ROOM, CountDemand, most_of
from .sizes import MEANS, MeanSize


class NegativeBinomialTable(CaseTable):
    """`[demand]` of kind "negative-binomial"."""

    kind: Literal["negative-binomial"]
    mean: MeanSize = Field(description=MEANS)
    deviation: Positive = Field(description="a number above 0, above the root of the mean")


@register
class NegativeBinomialDemand(CountDemand):
    """p(k) = G(k + r) / (G(r) k!) (r / (r + m))^r (m / (r + m))^k, G the gamma function.

    r = mean^2 / (deviation^2 - mean) of a period with the factor 1, and the same for all periods.
    """

    kind = "negative-binomial"
    table = NegativeBinomialTable
    maximum: int
    mean: float
    spread: float
    unit: str

    @classmethod
    def read(cls, section: TableContext, table: NegativeBinomialTable, unit: str, maximum: float):
        if table.deviation**2 <= 1.01 * table.mean:
            minimum = (1.01 * table.mean) ** 0.5
            message = f"allowed is a number above {minimum:.4g}, of a Poisson demand; see that kind"
            raise section.error("deviation", table.deviation, message)
        if table.deviation > 10 * table.mean:
            message = f"allowed is at most ten times the mean, {10 * table.mean:g}"
            raise section.error("deviation", table.deviation, message)
        size = table.mean**2 / (table.deviation**2 - table.mean)
        mean = ROOM * maximum * table.mean
        result = most_of(stats.nbinom(size, size / (size + mean)).ppf)
        return cls(result, table.mean, table.deviation, unit)

    def inputs(self):
        return mean_given(self.mean, self.unit), deviation_given(self.spread, self.unit)

    def logarithms(self, parameters, factor, k):
        mean, size = parameters[MEAN] * factor, _size(parameters)
        available = gammaln(k + size) - gammaln(size) - gammaln(k + 1.0)
        return available - size * jnp.log1p(mean / size) - k * jnp.log1p(size / mean)

    def deviation(self, parameters, factors):
        mean = parameters[MEAN] * factors
        return (mean + mean**2 / _size(parameters)) ** 0.5

    def describe(self) -> str:
        return f"negative binomial, mean {self.mean:g}, standard deviation {self.spread:g}"


def _size(parameters):
    mean = parameters[MEAN]
    return mean**2 / (parameters[DEVIATION] ** 2 - mean)
