"""Demand in whole units: the quantile of its distribution, with a derivative with respect to its
parameters.

Demand k is drawn if the uniform number u is between F(k - 1) and F(k), where F is the distribution
function. A step function has no useful derivative; this one gets

    d demand = - d F(k - 1) / p(k),        p(k) = F(k) - F(k - 1).

With it, the derivative of E f(demand) is exact for every f that is linear between whole numbers, if
the left derivative of f is used at whole numbers: by summation by parts it is the sum over k of
(f(k) - f(k - 1)) (-d F(k - 1)). Costs of an inventory with whole orders are such functions of every
demand. For a Poisson demand d demand / d mean is k / mean.

At whole numbers the simulator uses the right derivative with respect to stock and, in the same way,
the left derivative with respect to demand.

If demand is spread, it is k - 1/2 + (u - F(k - 1)) / p(k). This quantile is continuous, has the
same mean and a variance larger by 1/12, and is differentiated directly.

Kinds of `[demand]`: "poisson", "geometric" and "negative-binomial".
"""

import abc
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, doc
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, Float, jax, jnp

from .base import DEVIATION, MEAN, Demand, Parameters, deviation_key, mean_key, register

LARGEST = Range(0.0, 1000.0, "(]", note=": if demand is larger, use a larger unit, such as boxes")
TAIL = 1e-8  # the probability of a demand above those that are counted
ROOM = 1.1  # the mean may rise by a tenth (a report moves it by 1 %)


class CountDemand(Demand):
    """Demand 0, 1, … up to `maximum`; the last value includes all larger demands.

    - `maximum`: the number of distinguished demands above zero.
    """

    integer = True
    maximum: int = field(static=True)

    @abc.abstractmethod
    def logarithms(self, parameters: Parameters, factor: Array, k: Array) -> Array:
        """ln of the probability of demand `k`, in the common broadcast shape of `k` and the
        parameters."""

    def prepare(self, parameters: Parameters, factors: Float[Array, " T"]) -> Any:
        """`below` [T, K]: F(k - 1); `probability` [T, K]: p(k)."""
        k = jnp.arange(self.maximum)
        probability = jnp.exp(self.logarithms(parameters, factors[:, None], k))
        upto = jnp.cumsum(probability, 1)
        rest = jnp.maximum(1 - upto[:, -1:], TAIL / 1000)
        nothing = jnp.zeros_like(rest)
        below = jnp.concatenate([nothing, upto], 1)
        return {"below": below, "chance": jnp.concatenate([probability, rest], 1)}

    def draw(self, now: Any, normal: Float[Array, ""], spread: bool) -> Float[Array, ""]:
        below, probability = now["below"], now["chance"]
        uniform = jax.scipy.special.ndtr(normal)
        k = jnp.sum(uniform >= below[1:]).astype(jnp.int32)
        start, size = below[k], jax.lax.stop_gradient(probability[k])
        if not spread:
            return k + _moved(start, size)
        # Where u lies between F(k - 1) and F(k): the quantile function, joined by straight lines.
        share = jax.lax.stop_gradient(jnp.clip((uniform - start) / size, 0.0, 1.0))
        return k + share - 0.5 + _moved(start + share * probability[k], size)

    def probabilities(self, parameters: Parameters, factor: float = 1.0) -> Float[np.ndarray, " n"]:
        with jax.enable_x64(True):
            k, values = jnp.arange(self.maximum), jnp.asarray(float(factor))
            return np.asarray(jnp.exp(self.logarithms(parameters, values, k)))


def _moved(level: Array, size: Array) -> Array:
    """0, with the derivative of -level / size, which is the derivative of a quantile with respect
    to the parameters of its distribution."""
    return (jax.lax.stop_gradient(level) - level) / size


def count_mean() -> Any:
    """The key `mean` of demand in whole units; its range is limited, because every number of units
    is distinguished."""
    return mean_key(LARGEST)


def most_of(probabilities: Callable[[np.ndarray], np.ndarray]) -> int:
    """The largest distinguished demand; `probabilities`: the probabilities of all demands at the
    largest mean."""
    count = 64
    while (upto := np.cumsum(probabilities(np.arange(count + 1.0))))[-1] < 1 - TAIL:
        count *= 2
    return int(np.argmax(upto >= 1 - TAIL)) + 1


def poisson(mean: float) -> Callable[[np.ndarray], np.ndarray]:
    """The probability of each demand, in NumPy."""
    return lambda k: np.exp(k * math.log(mean) - mean - _log_factorial(k))


def negative_binomial(size: float, mean: float) -> Callable[[np.ndarray], np.ndarray]:
    """The probability of each demand, in NumPy."""

    def probabilities(k: np.ndarray) -> np.ndarray:
        available = _log_factorial(k + size - 1) - math.lgamma(size) - _log_factorial(k)
        return np.exp(available - size * math.log1p(mean / size) - k * math.log1p(size / mean))

    return probabilities


def _log_factorial(k: np.ndarray) -> np.ndarray:
    return np.array([math.lgamma(x + 1) for x in k.tolist()])


class GeometricTable(CaseTable):
    """`[demand]` of kind "geometric"."""

    kind: Literal["geometric"] = doc("geometric demand, with variance mean (1 + mean)")
    mean: CaseInput = count_mean()


@register
class GeometricDemand(CountDemand):
    """p(k) = (1 - q) q^k with q = m / (1 + m), where m is the mean of the period."""

    kind = "geometric"
    table = GeometricTable
    mean: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: GeometricTable, maximum: float):
        mean = ROOM * maximum * table.mean.values[0]
        return cls(most_of(negative_binomial(1.0, mean)), table.mean)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - (k + 1) * jnp.log1p(mean)

    def deviation(self, parameters, factors):
        mean = parameters[MEAN] * factors
        return (mean * (1 + mean)) ** 0.5

    def describe(self) -> str:
        return f"geometric, mean {self.mean.values[0]:g}"


class NegativeBinomialTable(CaseTable):
    """`[demand]` of kind "negative-binomial"."""

    kind: Literal["negative-binomial"] = doc("negative binomial demand, more variable than Poisson")
    mean: CaseInput = count_mean()
    deviation: CaseInput = deviation_key(", above the square root of the mean")


@register
class NegativeBinomialDemand(CountDemand):
    """p(k) = G(k + r) / (G(r) k!) (r / (r + m))^r (m / (r + m))^k, where G is the gamma function.
    The parameter r = mean^2 / (deviation^2 - mean) is computed for a period with the factor 1, and
    is the same for all periods.
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
            message = (
                f"it must be a number above {minimum:.4g}, the standard deviation of a Poisson "
                f"demand; "
                'for a Poisson demand use kind "poisson"'
            )
            raise section.error("deviation", deviation, message)
        if deviation > 10 * mean:
            message = f"it must be at most ten times the mean, {10 * mean:g}"
            raise section.error("deviation", deviation, message)
        size = mean**2 / (deviation**2 - mean)
        largest = ROOM * maximum * mean
        result = most_of(negative_binomial(size, largest))
        return cls(result, table.mean, table.deviation)

    def logarithms(self, parameters, factor, k):
        mean, size = parameters[MEAN] * factor, _size(parameters)
        gammaln = jax.scipy.special.gammaln
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


class PoissonTable(CaseTable):
    """`[demand]` of kind "poisson"."""

    kind: Literal["poisson"] = doc("Poisson demand")
    mean: CaseInput = count_mean()


@register
class PoissonDemand(CountDemand):
    """p(k) = e^-m m^k / k!, where m is the mean of the period."""

    kind = "poisson"
    table = PoissonTable
    mean: CaseInput

    @classmethod
    def read(cls, section: TableContext, table: PoissonTable, maximum: float):
        mean = ROOM * maximum * float(table.mean.values[0])
        return cls(most_of(poisson(mean)), table.mean)

    def logarithms(self, parameters, factor, k):
        mean = parameters[MEAN] * factor
        return k * jnp.log(mean) - mean - jax.scipy.special.gammaln(k + 1.0)

    def deviation(self, parameters, factors):
        return (parameters[MEAN] * factors) ** 0.5

    def describe(self) -> str:
        return f"Poisson, mean {self.mean.values[0]:g}"
