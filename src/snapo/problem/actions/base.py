"""What every set of actions can do."""

import abc
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float


def count(name: str, values: Any, minimum: int, more: str = "") -> int:
    """A whole number of at least `minimum`.

    **Raises:** `ValueError` for anything else; `more` ends its sentence.
    """
    available = isinstance(values, int | np.integer) and not isinstance(values, bool)
    if not available or values < minimum:
        raise ValueError(
            f"{name} is {values!r}; allowed is a whole number of at least {minimum}{more}."
        )
    return int(values)


class Actions(eqx.Module):
    """Where a decision lies: `size` numbers, and the way in from a network's unbounded ones.

    A set has two forms. The smooth one, of training, has a derivative everywhere; the exact one,
    of the value, holds the decisions that can be taken. `smooth` says which is meant, as it does
    in a simulator.
    """

    size: eqx.AbstractVar[int]

    @abc.abstractmethod
    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """Maps unbounded numbers into the set."""

    @abc.abstractmethod
    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """An action of the set, moved by an unbounded correction, and still in the set."""

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """The action of the exact set nearest to one of the smooth set; in training, itself."""
        return action

    @property
    def exploration_size(self) -> int:
        """How many normals `explore` takes; 0 for a set whose smooth form explores by itself."""
        return 0

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """An action of the smooth set that is drawn at random to this share, 0 to 1."""
        return action

    @abc.abstractmethod
    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        """What is wrong with these numbers for the exact set, and a remedy; None if nothing is."""

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """[size] low and [size] high, in float64: 0 and 1, unless the set has others."""
        return np.zeros(self.size), np.ones(self.size)

    def together(self) -> list[list[int]]:
        """The components in groups whose members cannot move alone: by default each by itself."""
        return [[i] for i in range(self.size)]


ROUNDING = 1e-5  # of a bound, in float32
