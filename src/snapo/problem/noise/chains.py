"""Noise made of other noise or of data: correlated noises that move together, empirical noise that
repeats a history, and the regimes of a Markov chain."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from .base import Noise, concrete, draw, leaves, only, parameter, prepare, size, uniform
from .continuous import cholesky, many, refuse_correlation


class Markov(Noise):
    """The next of k regimes. The state holds the regime, a whole number from 0:

        regime, likelihood = constants["regimes"].weigh(noise[:1], state["regime"])
        weight = state["weight"] * likelihood
        … {"cash": weight * cash}

    Regimes have no order, so that a path has no derivative with respect to the probabilities.
    `likelihood` is the number 1, with the derivative of the log probability; used as above, it
    makes the derivative of the mean correct (likelihood ratio). To draw without the likelihood, use
    `draw(noise[:1], state["regime"])`.

    **Arguments:**

    - `transition` [k, k]: probabilities of going from the row's regime to the column's. Rows are
      divided by their sums, and derivatives are those of the resulting probabilities.
    """

    separate = True

    transition: Any = parameter()

    def __check_init__(self):
        p = concrete(self.transition)
        if p is None:
            return
        if p.ndim < 2 or p.shape[-1] != p.shape[-2]:
            raise ValueError(
                f"Markov: transition has shape {p.shape}; it must be [regimes, regimes]."
            )
        if np.any(p < 0) or np.any(p.sum(-1) <= 0):
            message = "a probability below 0, or a row whose probabilities are all 0"
            raise ValueError(f"Markov: transition has {message}.")

    def probabilities(self, regime: Int[Array, ""]) -> Float[Array, " k"]:
        """The probabilities of the next regime."""
        p = jnp.asarray(self.transition)
        # Rows are read by selection: the table is small.
        row = (jnp.arange(p.shape[0]) == regime).astype(p.dtype) @ p
        return row / row.sum()

    def draw(self, normals, *state):
        return self.weigh(normals, *state)[0]

    def weigh(self, normals: Float[Array, " 1"], *state: Any) -> tuple[Array, Array]:
        """(next regime, likelihood)."""
        if len(state) != 1:
            raise ValueError("Markov: pass the present regime as well: draw(normals, regime).")
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


class Empirical(Noise):
    """One row of a history, drawn at random: `values` [n], or [n, K] whose rows stay together.

    Rows are sorted by their first number, so that a pair of antithetic paths draws a high and a low
    row. The derivative with respect to the history's numbers is pathwise, since every draw is one
    of them.
    """

    values: Any = parameter()
    ordered: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        values = concrete(self.values)
        if values is not None and (values.ndim not in (1, 2) or not len(values)):
            raise ValueError(
                f"Empirical: values have shape {values.shape}; it must be [n] or [n, K]."
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


class Correlated(Noise):
    """A tree of noises of any distributions, whose normals are correlated.

    `correlation` is that of the first normal of every noise (a Gaussian copula), as the strict
    lower triangle row by row, in the order of the tree; a dictionary has the order of its sorted
    keys. A draw has the structure of the tree.

        snapo.noise.Correlated({"demand": Poisson(4.0), "price": LogNormal(0.0, 0.2)}, [0.6])
    """

    noises: PyTree
    correlation: Any = parameter()
    root: Any = None

    def __check_init__(self):
        refuse_correlation(self)
        count = len(leaves(self.noises))
        if many(self.correlation) != count:
            raise ValueError(
                f"Correlated: there are {count} noises; the strict lower triangle must have "
                f"{count * (count - 1) // 2} numbers."
            )

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return size(self.noises)

    def prepare(self) -> "Correlated":
        if self.root is not None:
            return self
        return Correlated(prepare(self.noises), self.correlation, cholesky(self.correlation))

    def draw(self, normals, *state):
        made, first, positions = self.prepare(), 0, []
        for leaf in leaves(made.noises):
            positions.append(first)
            first += leaf.size
        mixed = made.root @ jnp.stack([normals[p] for p in positions])
        together = [
            mixed[positions.index(i)] if i in positions else normals[i] for i in range(first)
        ]
        return draw(made.noises, jnp.stack(together))
