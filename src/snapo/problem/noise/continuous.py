"""Noise with a smooth quantile function of closed form: derivatives along the path are exact."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .base import Noise, concrete, only, parameter, refuse, uniform


class Uniform(Noise):
    """Between `low` and `high`. Its derivative by both is pathwise."""

    low: Any = parameter(default=0.0)
    high: Any = parameter(default=1.0)

    def __check_init__(self):
        low, high = concrete(self.low), concrete(self.high)
        if low is not None and high is not None and np.any(high < low):
            raise ValueError(f"Uniform: high is {high.tolist()}, below low, {low.tolist()}.")

    def draw(self, normals, *state):
        return self.low + (self.high - self.low) * uniform(only(normals))


class Normal(Noise):
    """Normal numbers: one, or K that are correlated. Derivatives by all parameters are pathwise.

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
    """exp(mean + deviation z): `mean`, `deviation` of the logarithm. Derivatives are pathwise."""

    mean: Any = parameter(default=0.0)
    deviation: Any = parameter(default=1.0)

    def draw(self, normals, *state):
        return jnp.exp(self.mean + self.deviation * only(normals))


class Exponential(Noise):
    """Waiting times and jump heights with this mean. Its derivative is pathwise."""

    mean: Any = parameter(default=1.0)

    def __check_init__(self):
        refuse(self, "mean")

    def draw(self, normals, *state):
        z = only(normals)
        low = uniform(-jnp.abs(z))
        return -self.mean * jnp.where(z < 0, jnp.log1p(-low), jnp.log(low))


def many(correlation: Any) -> int:
    """The number K of numbers whose strict lower triangle this is; 1 for None."""
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
    """The lower root of the correlation matrix."""
    return jnp.linalg.cholesky(matrix(correlation))


def refuse_correlation(noise: Any) -> None:
    """Refuses a triangle of the wrong length, or one that is no correlation."""
    if noise.correlation is None or (lower := concrete(noise.correlation)) is None:
        return
    name, k = type(noise).__name__, many(noise.correlation)
    if lower.ndim < 1 or lower.shape[-1] != k * (k - 1) // 2:
        raise ValueError(
            f"{name}: correlation has shape {lower.shape}; it is the strict lower triangle row by "
            "row, 1 number for 2 components, 3 for 3, 6 for 4."
        )
    rows, columns = np.tril_indices(k, -1)
    for item in lower.reshape(-1, lower.shape[-1]):
        full = np.eye(k)
        full[rows, columns] = full[columns, rows] = item
        if np.linalg.eigvalsh(full)[0] <= 0:
            raise ValueError(f"{name}: {item.tolist()} is no correlation: not positive definite.")
