"""All that is known of a real environment so far, and the units in which a policy sees it."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snapo.problem.policy import MLP
from snapo.solver.learning.features import layers, plain, scaled

from .real import Act, Episode, Real
from .transitions import Transitions, circles, joined, scale_of


class Units(NamedTuple):
    """Shift and scale [k] of what a policy sees in training: fixed, or weights lost their sense."""

    shift: np.ndarray
    scale: np.ndarray

    def undone(self, policy: MLP) -> MLP:
        """The policy that takes observations as the environment gives them: no network of a kind
        of its own, so that it is saved and exported as every policy is."""
        return _with_layer(policy, plain(*_layer(policy), self.shift, self.scale))

    def done(self, policy: MLP) -> MLP:
        """The way back."""
        return _with_layer(policy, scaled(*_layer(policy), self.shift, self.scale))


@dataclass
class Known:
    """The real environment and all episodes so far.

    `units` and `circles` (see `transitions.circles`) are those of the random episodes.
    """

    real: Real
    rng: np.random.Generator
    units: Units
    circles: tuple[tuple[int, int], ...] = ()
    episodes: list[Episode] = field(default_factory=list)

    @staticmethod
    def of(real: Real, seed: int) -> "Known":
        """Nothing yet."""
        nothing = Units(np.zeros(0), np.ones(0))
        return Known(real, np.random.default_rng((seed, 1)), nothing)

    def settled(self) -> "Known":
        """With the units of all that was seen so far."""
        observed = self.transitions
        every = np.concatenate([observed.before, observed.after]).astype(np.float64)
        return replace(self, units=Units(*scale_of(every)), circles=circles(every))

    @property
    def transitions(self) -> Transitions:
        """All transitions."""
        return joined([episode.rows for episode in self.episodes])

    @property
    def firsts(self) -> Float[np.ndarray, "n k"]:
        """The first observations of all episodes."""
        return np.stack([episode.start for episode in self.episodes])

    def play(self, act: Act, seed: int | None = None) -> Episode:
        """One more episode."""
        seed = int(self.rng.integers(2**31)) if seed is None else seed
        self.episodes.append(self.real.episode(act, seed))
        return self.episodes[-1]

    def room(self, steps: float) -> bool:
        """Whether one more episode ends within so many steps, however long it takes."""
        return self.real.steps + self.real.limit <= steps


def _layer(policy: MLP) -> tuple[np.ndarray, np.ndarray]:
    """Weights and biases of the first layer, in float64: what is far from zero loses no digits."""
    weights, bias = layers(policy)[0]
    return np.asarray(weights, np.float64), np.asarray(bias, np.float64)


def _with_layer(policy: MLP, numbers) -> MLP:
    first = tuple(jnp.asarray(number, jnp.float32) for number in numbers)
    return eqx.tree_at(lambda item: layers(item)[0], policy, first)
