"""Noise with a smooth quantile function of closed form: derivatives along the path are exact.

Gamma and Student noise have their quantiles on a grid, computed once, with implicit derivatives.

The logarithm y of a gamma number is smooth in the normal z at the same quantile. Its values
and slopes are on 512 intervals of z, and a draw reads a cubic between two of them: within 1e-8 of
the quantile, for any shape. The derivative with respect to the shape is that of the equation
P(shape, e^y) = u (implicit reparametrisation: Figurnov, Mohamed and Mnih 2018).
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import digamma, gammainc, gammaincc, gammaln, log_ndtr, ndtr
from jaxtyping import Array, Float

from .base import Noise, concrete, only, parameter, refuse, uniform


class Uniform(Noise):
    """A uniform number between `low` and `high`. Its derivatives with respect to both are
    pathwise."""

    low: Any = parameter(default=0.0)
    high: Any = parameter(default=1.0)

    def __check_init__(self):
        low, high = concrete(self.low), concrete(self.high)
        if low is not None and high is not None and np.any(high < low):
            raise ValueError(f"Uniform: high, {high.tolist()}, is below low, {low.tolist()}.")

    def draw(self, normals, *state):
        return self.low + (self.high - self.low) * uniform(only(normals))


class Normal(Noise):
    """A normal number, or K correlated ones. All derivatives are pathwise.

    **Arguments:**

    - `mean`, `deviation`: numbers, or [K].
    - `correlation`: the strict lower triangle [K (K - 1) / 2], row by row; None: one number.

    >>> snapo.noise.Normal(correlation=[0.5, 0.2, -0.1]).size
    3
    """

    mean: Any = parameter(default=0.0)
    deviation: Any = parameter(default=1.0)
    correlation: Any = parameter(default=None)
    root: Any = None

    def __check_init__(self):
        refuse_correlation(self)

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return many(self.correlation)

    def prepare(self) -> "Normal":
        if self.correlation is None or self.root is not None:
            return self
        return Normal(self.mean, self.deviation, self.correlation, cholesky(self.correlation))

    def draw(self, normals, *state):
        if self.correlation is None:
            return self.mean + self.deviation * only(normals)
        return self.mean + self.deviation * (self.prepare().root @ normals)


class LogNormal(Noise):
    """exp(mean + deviation z): `mean` and `deviation` are those of the logarithm. Derivatives are
    pathwise."""

    mean: Any = parameter(default=0.0)
    deviation: Any = parameter(default=1.0)

    def draw(self, normals, *state):
        return jnp.exp(self.mean + self.deviation * only(normals))


class Exponential(Noise):
    """An exponential number with this mean, as for waiting times and jump heights. Its derivative
    is pathwise."""

    mean: Any = parameter(default=1.0)

    def __check_init__(self):
        refuse(self, "mean")

    def draw(self, normals, *state):
        z = only(normals)
        low = uniform(-jnp.abs(z))
        return -self.mean * jnp.where(z < 0, jnp.log1p(-low), jnp.log(low))


def many(correlation: Any) -> int:
    """The dimension K of the matrix whose strict lower triangle this is; 1 for None."""
    if correlation is None:
        return 1
    value = getattr(correlation, "value", correlation)
    return round((1 + (1 + 8 * np.shape(value)[-1]) ** 0.5) / 2)


def matrix(correlation: Any) -> Float[Array, "K K"]:
    """The correlation matrix of a strict lower triangle."""
    k = many(correlation)
    rows, columns = np.tril_indices(k, -1)
    lower = jnp.zeros((k, k), jnp.asarray(correlation).dtype)
    lower = lower.at[rows, columns].set(jnp.asarray(correlation))
    return lower + lower.T + jnp.eye(k)


def cholesky(correlation: Any) -> Float[Array, "K K"]:
    """The lower Cholesky factor of the correlation matrix."""
    return jnp.linalg.cholesky(matrix(correlation))


def refuse_correlation(noise: Any) -> None:
    """Refuses a triangle of the wrong length, or one that is not a correlation."""
    if noise.correlation is None or (lower := concrete(noise.correlation)) is None:
        return
    name, k = type(noise).__name__, many(noise.correlation)
    if lower.ndim < 1 or lower.shape[-1] != k * (k - 1) // 2:
        raise ValueError(
            f"{name}: correlation has shape {lower.shape}; it must be the strict lower triangle "
            "row by row, 1 number for 2 components, 3 for 3, 6 for 4."
        )
    rows, columns = np.tril_indices(k, -1)
    for item in lower.reshape(-1, lower.shape[-1]):
        full = np.eye(k)
        full[rows, columns] = full[columns, rows] = item
        if np.linalg.eigvalsh(full)[0] <= 0:
            raise ValueError(
                f"{name}: correlation is {item.tolist()}; the correlation matrix with this strict "
                "lower triangle must be positive definite."
            )


END = 6.5  # normals of 32 bits end at 6.34
INTERVALS = 512
MINIMUM = 0.05  # of a shape: the smallest numbers then are e^-450
GRID = np.linspace(-END, END, INTERVALS + 1)
STEP = 2 * END / INTERVALS
HALVINGS = 32  # after which two steps of Newton's leave only rounding
DEEP = -30.0  # the logarithm of a number so small that P(a, x) is x^a / gamma(a + 1)


class Logarithm(Noise):
    """ln of a gamma number with scale 1, interpolated in `rows` [nodes, 2]: its values and
    slopes."""

    rows: Float[Array, "nodes 2"]

    @classmethod
    def of(cls, shape: Any) -> "Logarithm":
        shape = jnp.asarray(shape) * 1.0
        y = _quantiles(shape)
        density = shape * y - jnp.exp(y) - gammaln(shape)  # ln of that of y
        slope = jnp.exp(-(GRID**2) / 2 - math.log(2 * math.pi) / 2 - density)
        return cls(jnp.stack([y, STEP * slope], -1))

    def draw(self, normals, *state):
        position = (only(normals) + END) / STEP
        start = jnp.clip(jnp.floor(jax.lax.stop_gradient(position)), 0, INTERVALS - 1)
        i, t = start.astype(jnp.int32), position - start
        left = jnp.take(self.rows, i, axis=0, mode="clip")
        right = jnp.take(self.rows, i + 1, axis=0, mode="clip")
        rise = right[0] - left[0]
        bend = (1 - t) * (left[1] - rise) - t * (right[1] - rise)
        return left[0] + t * (rise + (1 - t) * bend)


@jax.custom_jvp
def _quantiles(shape: Float[Array, ""]) -> Float[Array, " nodes"]:
    """ln x at every node of the grid, where P(shape, x) is the uniform number of the node."""
    half, tail = INTERVALS // 2, ndtr(-np.abs(GRID))

    def excess(y):
        """The distance of y above its quantile, measured in the smaller of both tails."""
        x = jnp.exp(y)
        lower = gammainc(shape, x[:half]) - tail[:half]
        return jnp.concatenate([lower, tail[half:] - gammaincc(shape, x[half:])])

    def nearer(number, result):
        low, high, y = result
        outside = excess(y)
        low, high = jnp.where(outside > 0, low, y), jnp.where(outside > 0, y, high)
        density = jnp.exp(shape * y - jnp.exp(y) - gammaln(shape))
        newton = y - outside / jnp.where(density > 0, density, 1.0)
        return low, high, jnp.where(number < HALVINGS, (low + high) / 2, newton)

    # P(a, x) <= x^a / gamma(a + 1), and 10 deviations and 60 above the mean nothing is left.
    low = (log_ndtr(GRID) + gammaln(shape + 1)) / shape - 1e-6
    high = jnp.broadcast_to(jnp.log(shape + 10 * jnp.sqrt(shape) + 60), low.shape)
    # One loop for both ways: an incomplete gamma function takes a second to compile.
    return jax.lax.fori_loop(0, HALVINGS + 2, nearer, (low, high, (low + high) / 2))[2]


@_quantiles.defjvp
def _implicit(primals, tangents):
    (shape,), (moved,) = primals, tangents
    y = _quantiles(shape)
    x, wide = jnp.exp(jnp.maximum(y, DEEP)), jnp.broadcast_to(shape, y.shape)
    density = jnp.exp(shape * jnp.maximum(y, DEEP) - x - gammaln(shape))
    usual = -jax.lax.igamma_grad_a(wide, x) / density
    deep = (digamma(shape + 1) - y) / shape
    return y, jnp.where(y > DEEP, usual, deep) * moved


class Gamma(Noise):
    """A gamma number with mean shape x scale and variance shape x scale^2. Its derivatives are
    pathwise (implicit). Prepare it with `snapo.noise.prepare`: otherwise its grid is computed at
    every step, which the native engine does not support.
    """

    shape: Any = parameter()
    scale: Any = parameter(default=1.0)
    logarithm: Logarithm | None = None

    def __check_init__(self):
        refuse(self, "shape", MINIMUM)
        refuse(self, "scale")

    def prepare(self) -> "Gamma":
        if self.logarithm is not None:
            return self
        return Gamma(self.shape, self.scale, Logarithm.of(self.shape))

    def draw(self, normals, *state):
        made = self.prepare().logarithm
        assert made is not None
        return self.scale * jnp.exp(made.draw(normals))


class Student(Noise):
    """mean + scale t, where t is Student's with `df` degrees of freedom: a normal divided by the
    root of a gamma number. It is one number, or K correlated numbers that share that root.

    All derivatives are pathwise. It takes one normal more than it returns numbers.

    **Arguments:**

    - `df`: above 0.1; any number, whole or not. The variance of t is df / (df - 2).
    - `mean`, `scale`: numbers, or [K].
    - `correlation`: as in `Normal`.
    """

    df: Any = parameter()
    mean: Any = parameter(default=0.0)
    scale: Any = parameter(default=1.0)
    correlation: Any = parameter(default=None)
    logarithm: Logarithm | None = None
    root: Any = None

    def __check_init__(self):
        refuse(self, "df", 2 * MINIMUM)
        refuse_correlation(self)

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return many(self.correlation) + 1

    def prepare(self) -> "Student":
        if self.logarithm is not None:
            return self
        root = None if self.correlation is None else cholesky(self.correlation)
        logarithm = Logarithm.of(jnp.asarray(self.df) / 2)
        return Student(self.df, self.mean, self.scale, self.correlation, logarithm, root)

    def draw(self, normals, *state):
        made = self.prepare()
        assert made.logarithm is not None
        # chi^2 / df = 2 gamma(df / 2) / df
        spread = jnp.exp(-made.logarithm.draw(normals[-1:]) / 2) * jnp.sqrt(
            jnp.asarray(made.df) / 2
        )
        z = normals[0] if made.root is None else made.root @ normals[:-1]
        return made.mean + made.scale * spread * z
