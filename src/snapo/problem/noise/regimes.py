"""Regimes: calm and stormy, open and shut; a chain of Markov."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .base import Noise, concrete, only, parameter, uniform


class Markov(Noise):
    """The next of k regimes. The state holds the regime, a whole number from 0:

        regime, likelihood = constants["regimes"].weigh(noise[:1], state["regime"])
        weight = state["weight"] * likelihood
        … {"cash": weight * cash}

    Regimes have no order, so that a path has no derivative by the chances. `likelihood` is the
    number 1, with the derivative of the log probability; carried along as here, it makes the
    derivative of the mean right (likelihood ratio). Without: `draw(noise[:1], state["regime"])`.

    **Arguments:**

    - `transition` [k, k]: from the row's regime to the column's. Rows are divided by their sums,
      and derivatives are those of the chances so made.
    """

    separate = True

    transition: Any = parameter()

    def __check_init__(self):
        p = concrete(self.transition)
        if p is None:
            return
        if p.ndim < 2 or p.shape[-1] != p.shape[-2]:
            raise ValueError(f"Markov: transition has shape {p.shape}; it is [regimes, regimes].")
        if np.any(p < 0) or np.any(p.sum(-1) <= 0):
            raise ValueError("Markov: transition has a chance below 0, or a row without any.")

    def probabilities(self, regime: Int[Array, ""]) -> Float[Array, " k"]:
        """Of the next regime."""
        p = jnp.asarray(self.transition)
        # Rows are read by selection: the table is small.
        row = (jnp.arange(p.shape[0]) == regime).astype(p.dtype) @ p
        return row / row.sum()

    def draw(self, normals, *state):
        return self.weigh(normals, *state)[0]

    def weigh(self, normals: Float[Array, " 1"], *state: Any) -> tuple[Array, Array]:
        """(next regime, likelihood)."""
        if len(state) != 1:
            raise ValueError("Markov: give the present regime as well, draw(normals, regime).")
        probabilities = self.probabilities(state[0])
        upto = jnp.cumsum(jax.lax.stop_gradient(probabilities))[:-1]
        regime = jnp.sum((uniform(only(normals)) > upto).astype(jnp.int32))
        probability = (jnp.arange(probabilities.shape[0]) == regime).astype(
            probabilities.dtype
        ) @ probabilities
        selected = jax.lax.stop_gradient(probability)
        return regime, jnp.where(selected > 0, probability, 1.0) / jnp.where(
            selected > 0, selected, 1.0
        )
