"""Demand in whole units: the quantile of its distribution, with a derivative with respect to its
parameters.

Demand k is drawn if the uniform number u is between F(k - 1) and F(k), where F is the distribution
function. A step function has no useful derivative; this one is given

    d demand = - d F(k - 1) / p(k),        p(k) = F(k) - F(k - 1),

with which the derivative of E f(demand) is exact for every f that is linear between whole numbers,
if f is differentiated to the left at them: the sum of (f(k) - f(k - 1)) (-d F(k - 1)) over k, by
parts. Costs of an inventory with whole orders are such functions of every demand. For a Poisson
demand d demand / d mean is k / mean.

Between whole numbers the rule is to differentiate stock upwards and so demand downwards; the
simulator writes its corners so that they do.

Where demand is spread, it is k - 1/2 + (u - F(k - 1)) / p(k): continuous, with the same mean and a
variance larger by 1/12, and with the derivative of that quantile.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from snapo.case.quantity import Range

from .base import Demand, Parameters, mean_key

LARGEST = Range(0.0, 1000.0, "(]", note=": where demand is larger, count it in boxes")
TAIL = 1e-8  # the probability of a demand above those that are counted
ROOM = 1.1  # the mean may rise by a tenth (a report moves it by 1 %)


class CountDemand(Demand):
    """Demand 0, 1, … up to `maximum`; the last one includes all above.

    - `maximum`: the number of demands above zero that are distinguished.
    """

    integer = True
    maximum: int = eqx.field(static=True)

    @abc.abstractmethod
    def logarithms(self, parameters: Parameters, factor: Array, k: Array) -> Array:
        """ln of the probability of demand `k`, shaped like both together."""

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
        uniform = ndtr(normal)
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
    """0, with the derivative of -level / size: that of a quantile whose distribution moves."""
    return (jax.lax.stop_gradient(level) - level) / size


def count_mean() -> Any:
    """The key `mean` of demand in whole units, each of which is distinguished."""
    return mean_key(LARGEST)


def most_of(law: str, *parameters: float) -> int:
    """The largest distinguished demand, of SciPy's `law` at the largest mean."""
    from scipy import stats  # late: it takes a second to load

    return int(np.ceil(getattr(stats, law)(*parameters).ppf(1 - TAIL))) + 1
