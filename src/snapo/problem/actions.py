"""Sets of actions: where a decision lies, and how a network's free numbers come into it."""

import math

import equinox as eqx
import jax
from jaxtyping import Array, Float


class Box(eqx.Module):
    """Actions in a box: `size` numbers, each between `low` and `high` (infinite bounds allowed)."""

    size: int = eqx.field(static=True)
    low: float = eqx.field(static=True, default=-math.inf)
    high: float = eqx.field(static=True, default=math.inf)

    def __check_init__(self):
        if self.size < 1:
            raise ValueError(f"Box: size is {self.size}; an action has at least one number.")
        if not self.low < self.high:
            raise ValueError(
                f"Box: low is {self.low} and high is {self.high}; low must be below high."
            )

    def squash(self, raw: Float[Array, " size"]) -> Float[Array, " size"]:
        """Maps unbounded numbers into the box: the identity, a softplus or a logistic curve."""
        if math.isinf(self.low) and math.isinf(self.high):
            return raw
        if math.isinf(self.high):
            return self.low + jax.nn.softplus(raw)
        if math.isinf(self.low):
            return self.high - jax.nn.softplus(-raw)
        return self.low + (self.high - self.low) * jax.nn.sigmoid(raw)


class Simplex(eqx.Module):
    """Actions on the probability simplex: `size` numbers, none negative, that sum to one."""

    size: int = eqx.field(static=True)

    def __check_init__(self):
        if self.size < 2:
            raise ValueError(f"Simplex: size is {self.size}; shares of a whole need at least two.")

    def squash(self, raw: Float[Array, " size"]) -> Float[Array, " size"]:
        """Maps unbounded numbers onto the simplex by a softmax."""
        return jax.nn.softmax(raw)
