"""A few coordinates of a policy, along which its value is looked at: directions of its numbers.

For a network they are a shift and a gain of every raw output of its last layer, which move all
decisions together; for many outputs a common gain, what the second half of training changed, and
a few mixtures of the shifts. A rule with few numbers has one coordinate for each.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem.inputs import Frozen
from snapo.problem.policies.memory import GRU
from snapo.problem.policy import Network, Policy, trainable

EACH = 4  # outputs at most that have a shift and a gain of their own
MIXTURES = 4  # of the shifts of more outputs
FEW = 8  # numbers at most of a rule without a network that has a coordinate for each
SMALL = 1e-3  # the size that a number of a rule has at least, in its own coordinate


class Coordinates(NamedTuple):
    """Directions [n, P] in the P trained numbers of a policy; `policy` is their origin."""

    policy: Policy
    directions: np.ndarray

    def at(self, position: np.ndarray) -> Policy:
        """The policy at a place [n]."""
        return shifted_policy(self.policy, position @ self.directions)

    def leading(self, count: int) -> "Coordinates":
        """The first few alone."""
        return self._replace(directions=self.directions[:count])

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """[P] a random direction of all numbers, each drawn as large as its array's are."""
        # In float64: JAX's arrays and NumPy's would round the same numbers to other deviations.
        leaves = [np.asarray(x, np.float64) for x in jax.tree.leaves(trainable(self.policy)[0])]
        drawn = [rng.standard_normal(x.shape) * max(float(np.std(x)), SMALL) for x in leaves]
        return np.concatenate([np.zeros(0), *map(np.ravel, drawn)])


def shifted_policy(policy: Policy, by: np.ndarray) -> Policy:
    """The policy whose trained numbers, as one vector [P], are moved by so much."""
    numbers, rest = trainable(policy)
    leaves, structure = jax.tree.flatten(numbers)
    after, first = [], 0
    for leaf in leaves:
        old = np.asarray(leaf)
        step = by[first : first + old.size].reshape(old.shape)
        new = (old.astype(np.float64) + step).astype(old.dtype)
        # A policy may index its arrays as JAX's: they stay what they are.
        after.append(jnp.asarray(new) if isinstance(leaf, jax.Array) else new)
        first += old.size
    return eqx.combine(jax.tree.unflatten(structure, after), rest)


def coordinates(policy: Policy, earlier: Policy | None = None) -> Coordinates:
    """Of a policy; `earlier` is the one from halfway through its training."""
    numbers = _vector(policy)
    past = [] if earlier is None else [numbers - _vector(earlier)]
    past = [change for change in past if np.any(change)]
    shifts, gains = _of_outputs(policy)
    if not len(shifts) and numbers.size <= FEW:
        return Coordinates(policy, np.diag(np.maximum(np.abs(numbers), SMALL)))
    if not len(shifts):
        return Coordinates(policy, np.stack([numbers, *past]))
    if len(shifts) <= EACH:
        pairs = np.stack([shifts, gains], axis=1)
        return Coordinates(policy, pairs.reshape(-1, numbers.size))
    rng = np.random.default_rng(len(shifts))
    mixtures = np.linalg.qr(rng.standard_normal((len(shifts), MIXTURES)))[0].T @ shifts
    return Coordinates(policy, np.stack([gains.sum(0), *past, *mixtures]))


def _of_outputs(policy: Policy) -> tuple[np.ndarray, np.ndarray]:
    """[outputs, P] directions: one more of a raw output, and the output once more."""
    leaves = jax.tree.leaves(trainable(policy)[0])
    shifts, gains = [], []
    for network in _deciding(policy):
        weights, bias = network.weights[-1], network.biases[-1]
        for one in np.eye(len(bias)):
            shifts.append(_vector_of(leaves, {id(bias): one}))
            rows = {
                id(weights): np.asarray(weights) * one[:, None],
                id(bias): np.asarray(bias) * one,
            }
            gains.append(_vector_of(leaves, rows))
    size = sum(int(np.size(leaf)) for leaf in leaves)
    return np.reshape(shifts, (-1, size)), np.reshape(gains, (-1, size))


def _vector_of(leaves: list, changes: dict[int, np.ndarray]) -> np.ndarray:
    """Changes of some arrays, by their identity, as a vector of all numbers."""
    parts = [np.ravel(changes.get(id(leaf), np.zeros(np.shape(leaf)))) for leaf in leaves]
    return np.concatenate([np.zeros(0), *parts])


def _deciding(policy: PyTree) -> list[Network]:
    """The trained networks whose outputs become decisions."""
    if isinstance(policy, GRU):
        return [] if policy.readout is None else [policy.readout]
    kinds = Network | GRU | Frozen
    nodes = jax.tree.leaves(policy, is_leaf=lambda node: isinstance(node, kinds))
    networks = [_deciding(x) if isinstance(x, GRU) else [x] for x in nodes]
    return [x for group in networks for x in group if isinstance(x, Network)]


def _vector(policy: Policy) -> np.ndarray:
    leaves = jax.tree.leaves(trainable(policy)[0])
    return np.concatenate([np.zeros(0), *(np.ravel(np.asarray(x, np.float64)) for x in leaves)])
