"""Several noises that move together."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import PyTree

from .base import Noise, draw, leaves, parameter, prepare, size
from .continuous import cholesky, many, refuse_correlation


class Correlated(Noise):
    """A tree of noises, each with its own distribution, whose normals are correlated.

    `correlation` is that of the first normal of every noise (a Gaussian copula), as the strict
    lower triangle row by row, in the order of the tree: a dictionary's is that of its sorted keys.
    A draw is shaped like the tree.

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
                f"Correlated: there are {count} noises; their strict lower triangle has "
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
