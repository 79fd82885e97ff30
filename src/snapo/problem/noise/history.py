"""Noise that repeats a history."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .base import Noise, concrete, only, parameter, uniform


class Empirical(Noise):
    """One row of a history, by chance: `values` [n], or [n, K] whose rows stay together.

    Rows are in the order of their first number, so that antithetic paths see high and low ones. The
    derivative by the history's numbers is pathwise: every draw is one of them.
    """

    values: Any = parameter()
    ordered: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        values = concrete(self.values)
        if values is not None and (values.ndim not in (1, 2) or not len(values)):
            raise ValueError(
                f"Empirical: values have shape {values.shape}; allowed is [n] or [n, K]."
            )

    def prepare(self) -> "Empirical":
        if self.ordered:
            return self
        values = jnp.asarray(self.values)
        order = jnp.argsort(values if values.ndim == 1 else values[:, 0])
        return Empirical(jnp.take(values, order, axis=0), True)

    def draw(self, normals, *state):
        values = self.prepare().values
        n = np.shape(values)[0]
        k = jnp.floor(uniform(only(normals)) * n).astype(jnp.int32)
        return jnp.take(values, jnp.clip(k, 0, n - 1), axis=0, mode="clip")
