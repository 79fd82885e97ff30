"""Shares of a whole."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .base import ROUNDING, Actions, count


class Simplex(Actions):
    """Actions on the probability simplex: `size` numbers, none negative, that sum to one.

    >>> snapo.Simplex(4).squash(np.zeros(4)).tolist()
    [0.25, 0.25, 0.25, 0.25]
    """

    size: int = eqx.field(static=True)

    def __init__(self, size: int):
        self.size = count("Simplex: size", size, 2, ", the number of shares")

    def squash(self, raw: Float[Array, " size"], smooth=None) -> Float[Array, " size"]:
        """Maps unbounded numbers onto the simplex by a softmax."""
        return jax.nn.softmax(raw)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """Shares whose logarithms are those of `base` plus a correction."""
        return jax.nn.softmax(jnp.log(jnp.maximum(base, 1e-6)) + correction)

    @property
    def exploration_size(self) -> int:
        return self.size

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """(1 - share) action + share x, with shares x whose logarithms are normals times 2."""
        return (1 - share) * action + share * jax.nn.softmax(2 * normals)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        if np.all(action >= -ROUNDING) and abs(action.sum() - 1) <= 100 * ROUNDING:
            return None
        return (
            f"Its shares are {np.round(action, 4).tolist()}.",
            "A Simplex takes shares of at least 0 that sum to 1: action.squash(…).",
        )

    def together(self) -> list[list[int]]:
        return [list(range(self.size))]
