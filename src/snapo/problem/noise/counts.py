"""Whole numbers: the quantile of a discrete distribution, with a derivative with respect to its
parameters.

Number k is drawn if the uniform u is between F(k - 1) and F(k). A step function has no useful
derivative; a draw gets

    d k = -(d F(k - 1) + d F(k)) / (2 p(k)),        p(k) = F(k) - F(k - 1).

Summed over k by parts, the derivative of E f(k) then is the sum over k of -d F(k) times the mean of
f'(k) and f'(k + 1): the trapezoid's rule for f(k + 1) - f(k). It is exact for every f that is
quadratic between whole numbers without corners, and otherwise has an error of about a twelfth of
the third differences. At a corner at a whole number q, where JAX uses the mean of both slopes, the
error is a quarter of the change of slope times d F(q) - d F(q - 1): for the mean of a Poisson,
times p(q - 1) - p(q). If q differs between paths, this error averages out, but not at the end of
the range, where q is 0 and no draw is below it. `weigh` gives the likelihood ratio, which is
correct for any f, with more noise.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float

from .base import Noise, concrete, numbers, only, parameter, refuse, uniform

TAIL = 1e-10  # the probability of numbers above `maximum`
ROOM = 1.5  # parameters may rise by a half


class Drawn(Noise):
    """A distribution on 0, 1, …: F, the probabilities above each number, the probabilities, and the
    slope of a draw."""

    separate = True

    below: Float[Array, " K"]
    above: Float[Array, " K"]
    probability: Float[Array, " K"]
    moves: Float[Array, " K"]

    @classmethod
    def of(cls, probability: Float[Array, " K"]) -> "Drawn":
        """The probabilities of 0 … K - 1; the last one also gets the remainder to 1."""
        below = jnp.cumsum(probability)
        above = jnp.cumsum(probability[::-1])[::-1] - probability
        # From the nearer end: the other has lost the digits of a tail.
        middle = jnp.where(below < 0.5, -below + probability / 2, above + probability / 2)
        selected = jax.lax.stop_gradient(probability)
        real = selected > jnp.finfo(selected.dtype).tiny
        moves = jnp.where(real, middle / jnp.where(real, selected, 1.0), 0.0)
        return cls(below, above, probability, moves)

    def draw(self, normals, *state):
        k = self._index(only(normals))
        slope = jnp.take(self.moves, k, mode="clip")
        return k.astype(slope.dtype) + (slope - jax.lax.stop_gradient(slope))

    def weigh(self, normals):
        k = self._index(only(normals))
        probability = jnp.take(self.probability, k, mode="clip")
        selected = jax.lax.stop_gradient(probability)
        real = selected > 0
        return k.astype(selected.dtype), jnp.where(real, probability, 1.0) / jnp.where(
            real, selected, 1.0
        )

    def _index(self, z: Array) -> Array:
        """The number of F(k) below u; the upper half is counted from above, which keeps more
        digits."""
        z = jax.lax.stop_gradient(z)
        low = uniform(-jnp.abs(z))
        passed = jnp.where(z < 0, low > self.below[:-1], low < self.above[:-1])
        return jnp.sum(passed.astype(jnp.int32))


class Counts(Noise):
    """Whole numbers 0 … `maximum`. Subclass it and write `logarithms`.

    `draw` returns a number whose derivative with respect to the parameters is exact if outcomes
    are quadratic without corners, and nearly exact if the positions of corners differ between
    paths. `weigh` returns a number and its likelihood, whose derivatives are always correct.
    `maximum` is static, and follows from the parameters if these are known.
    """

    separate = True

    maximum: eqx.AbstractVar[int]

    @abc.abstractmethod
    def logarithms(self, k: Float[np.ndarray, " K"]) -> Float[Array, " K"]:
        """ln of the probability of every number `k`."""

    def prepare(self) -> Drawn:  # pyright: ignore[reportIncompatibleMethodOverride]
        return Drawn.of(jnp.exp(self.logarithms(np.arange(self.maximum + 1.0))))

    def draw(self, normals, *state):
        return self.prepare().draw(normals)

    def weigh(self, normals: Float[Array, " 1"]) -> tuple[Array, Array]:
        """The pair (number, likelihood): the number has no derivative; `likelihood` is 1, and its
        derivative is that of the number's log probability. The simulator keeps the product of all
        likelihoods in its state, and multiplies every output at or after the draw by it, as with
        `Choice.draw`.
        """
        return self.prepare().weigh(normals)


class Poisson(Counts):
    """p(k) = e^-mean mean^k / k!. If the mean is computed inside `step`, specify `maximum`.

    >>> [float(snapo.noise.Poisson(4.0).draw(np.array([z]))) for z in (-2.0, 0.0, 2.0)]
    [1.0, 4.0, 8.0]
    """

    mean: Any = parameter()
    maximum: int = eqx.field(static=True)

    def __init__(self, mean: Any, maximum: int | None = None):
        self.mean = numbers(mean)
        self.maximum = _most(self, "poisson", maximum, (self.mean,))

    def __check_init__(self):
        refuse(self, "mean")

    def logarithms(self, k):
        return k * jnp.log(self.mean) - self.mean - gammaln(k + 1.0)


class NegativeBinomial(Counts):
    """A count with this mean and variance mean + mean^2 / dispersion (a Poisson whose mean is gamma
    with shape `dispersion`)."""

    mean: Any = parameter()
    dispersion: Any = parameter()
    maximum: int = eqx.field(static=True)

    def __init__(self, mean: Any, dispersion: Any, maximum: int | None = None):
        self.mean, self.dispersion = numbers(mean), numbers(dispersion)
        r, m = concrete(self.dispersion), concrete(self.mean)
        probabilities = None if r is None or m is None else (r, r / (r + ROOM * m))
        self.maximum = _most(self, "nbinom", maximum, probabilities, 1.0)

    def __check_init__(self):
        refuse(self, "mean")
        refuse(self, "dispersion")

    def logarithms(self, k):
        mean, r = self.mean, jnp.asarray(self.dispersion)
        ways = gammaln(k + r) - gammaln(r) - gammaln(k + 1.0)
        return ways + r * jnp.log(r / (r + mean)) + k * jnp.log(mean / (r + mean))


class Binomial(Counts):
    """The number of successes in `maximum` independent trials, each with `probability`; 0 or 1 in
    one trial."""

    probability: Any
    maximum: int = eqx.field(static=True)

    def __init__(self, probability: Any, maximum: int = 1):
        self.probability, self.maximum = numbers(probability), maximum

    def __check_init__(self):
        refuse(self, "probability", 0.0, 1.0)

    def logarithms(self, k):
        ways = gammaln(self.maximum + 1.0) - gammaln(k + 1.0) - gammaln(self.maximum - k + 1.0)
        return (
            ways + k * jnp.log(self.probability) + (self.maximum - k) * jnp.log1p(-self.probability)
        )


def _most(noise: Noise, kind: str, maximum: int | None, parameters: Any, room: float = ROOM) -> int:
    """The largest number that a draw can have."""
    if maximum is not None:
        return maximum
    values = [concrete(item) for item in parameters or ()]
    if not values or any(entry is None for entry in values):
        raise ValueError(
            f"{type(noise).__name__}: specify maximum; it cannot be computed from a "
            "parameter that JAX traces."
        )
    from scipy import stats  # late: it takes a second to load

    first, *rest = [value for value in values if value is not None]
    largest = getattr(stats, kind).isf(TAIL, room * first, *rest)
    # A parameter that is refused has none.
    return 1 + int(np.max(np.nan_to_num(largest, posinf=0.0, neginf=0.0), initial=0.0))
