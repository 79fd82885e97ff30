"""`[demand]` of kind "negative-binomial"."""

from typing import Literal

import jax.numpy as jnp
from jax.scipy.special import gammaln

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable, TableContext

from .base import DEVIATION, MEAN, deviation_key, register
from .counts import ROOM, CountDemand, count_mean, most_of


class NegativeBinomialTable(CaseTable):
    """`[demand]` of kind "negative-binomial"."""

    kind: Literal["negative-binomial"]
    mean: CaseInput = count_mean()
    deviation: CaseInput = deviation_key(", above the root of the mean")


@register
class NegativeBinomialDemand(CountDemand):
    """p(k) = G(k + r) / (G(r) k!) (r / (r + m))^r (m / (r + m))^k, G the gamma function.

    r = mean^2 / (deviation^2 - mean) of a period with the factor 1, and the same for all periods.
    """

    kind = "negative-binomial"
    table = NegativeBinomialTable
    mean: CaseInput
    spread: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: NegativeBinomialTable, maximum: float):
        mean, deviation = float(table.mean.values[0]), float(table.deviation.values[0])
        if deviation**2 <= 1.01 * mean:
            minimum = (1.01 * mean) ** 0.5
            message = f"allowed is a number above {minimum:.4g}, of a Poisson demand; see that kind"
            raise section.error("deviation", deviation, message)
        if deviation > 10 * mean:
            message = f"allowed is at most ten times the mean, {10 * mean:g}"
            raise section.error("deviation", deviation, message)
        size = mean**2 / (deviation**2 - mean)
        largest = ROOM * maximum * mean
        result = most_of("nbinom", size, size / (size + largest))
        return cls(result, table.mean, table.deviation)

    def logarithms(self, parameters, factor, k):
        mean, size = parameters[MEAN] * factor, _size(parameters)
        available = gammaln(k + size) - gammaln(size) - gammaln(k + 1.0)
        return available - size * jnp.log1p(mean / size) - k * jnp.log1p(size / mean)

    def deviation(self, parameters, factors):
        mean = parameters[MEAN] * factors
        return (mean + mean**2 / _size(parameters)) ** 0.5

    def describe(self) -> str:
        mean, spread = self.mean.values[0], self.spread.values[0]
        return f"negative binomial, mean {mean:g}, standard deviation {spread:g}"


def _size(parameters):
    mean = parameters[MEAN]
    return mean**2 / (parameters[DEVIATION] ** 2 - mean)
