"""Policies: from what is observed to an action. Networks, residuals and classical rules.

A policy is any `eqx.Module` with `policy(observation, smooth) -> action` and the action in
the simulator's fixed set. Baselines are policies that plug in where the network goes.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .actions import Box, Simplex
from .inputs import Frozen


class Policy(eqx.Module):
    """One decision rule. Actions must lie in the simulator's fixed action set."""

    @abc.abstractmethod
    def __call__(self, observation: Float[Array, " features"], smooth) -> Float[Array, " size"]:
        """The action at this observation."""


class Network(eqx.Module):
    """A fully connected network with float32 weights: `widths` are features, hidden …, outputs.

    The last layer starts small (its weights divided by 100), so that a policy starts near the
    middle of its range and a residual starts at its base.
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    activation: Callable = eqx.field(static=True)

    def __init__(self, widths, *, key, activation: Callable = jax.nn.silu):
        keys = jax.random.split(key, len(widths) - 1)
        shapes = list(zip(widths[1:], widths[:-1]))
        self.weights = [
            jax.random.normal(k, shape, jnp.float32) / jnp.sqrt(jnp.float32(shape[1]))
            for k, shape in zip(keys, shapes)
        ]
        self.weights[-1] = self.weights[-1] / 100
        self.biases = [jnp.zeros(out, jnp.float32) for out in widths[1:]]
        self.activation = activation

    def __call__(self, x: Float[Array, " features"]) -> Float[Array, " outputs"]:
        for weight, bias in zip(self.weights[:-1], self.biases[:-1]):
            x = self.activation(weight @ x + bias)
        return self.weights[-1] @ x + self.biases[-1]


class MLP(Policy):
    """A network whose outputs are squashed into the action set (see `Box` and `Simplex`)."""

    network: Network
    action: Box | Simplex

    def __init__(
        self,
        action: Box | Simplex,
        features: int,
        *,
        key,
        hidden: tuple[int, ...] = (32, 32),
        activation: Callable = jax.nn.silu,
    ):
        self.network = Network((features, *hidden, action.size), key=key, activation=activation)
        self.action = action

    def __call__(self, observation, smooth):
        return self.action.squash(self.network(observation))


class Residual(Policy):
    """A base rule plus `scale` times a network, kept inside the action set.

    For a `Box` the sum is clipped (rounded while training), for a `Simplex` the network moves
    the logarithms of the base's shares. The base is not trained.
    """

    base: Frozen
    network: Network
    action: Box | Simplex
    scale: float = eqx.field(static=True)

    def __init__(self, base: Policy, action, features: int, *, key, scale=1.0, hidden=(32, 32)):
        self.base = Frozen(base)
        self.network = Network((features, *hidden, action.size), key=key)
        self.action = action
        self.scale = scale

    def __call__(self, observation, smooth):
        base = self.base.array(observation, smooth)
        correction = self.scale * self.network(observation)
        if isinstance(self.action, Simplex):
            return jax.nn.softmax(jnp.log(jnp.maximum(base, 1e-6)) + correction)
        low, high = self.action.low, self.action.high
        width = high - low if np.isfinite(high - low) else 1.0
        return smooth.clip(base + correction, low, high, scale=width)


class Constant(Policy):
    """Always the same action."""

    value: Array = eqx.field(converter=jnp.asarray)

    def __call__(self, observation, smooth):
        return self.value.astype(observation.dtype)


class Linear(Policy):
    """Linear feedback: gain @ observation + offset."""

    gain: Array = eqx.field(converter=jnp.asarray)
    offset: Array = eqx.field(converter=jnp.asarray, default=0.0)

    def __call__(self, observation, smooth):
        return self.gain @ observation + self.offset


class BaseStock(Policy):
    """Order up to a level: max(level - position, 0), the position being one observed number."""

    level: Array = eqx.field(converter=jnp.asarray)
    position: int = eqx.field(static=True, default=0)
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, observation, smooth):
        return smooth.positive_part(self.level - observation[self.position], self.scale)[None]


class Threshold(Policy):
    """`above` when the observed number exceeds the threshold, else `below`."""

    threshold: Array = eqx.field(converter=jnp.asarray)
    below: Array = eqx.field(converter=jnp.asarray)
    above: Array = eqx.field(converter=jnp.asarray)
    feature: int = eqx.field(static=True, default=0)
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, observation, smooth):
        on = smooth.indicator(observation[self.feature] - self.threshold, self.scale)
        return self.below + on * (self.above - self.below)


def trainable(policy: Policy) -> tuple[Policy, Policy]:
    """Splits a policy into what is trained and the rest (integers, `Frozen` tables)."""
    marks = jax.tree.map(
        lambda leaf: False if isinstance(leaf, Frozen) else eqx.is_inexact_array(leaf),
        policy,
        is_leaf=lambda leaf: isinstance(leaf, Frozen),
    )
    return eqx.partition(policy, marks)


def parameters(policy: Policy) -> np.ndarray:
    """All trained numbers of a policy in one vector."""
    leaves = jax.tree.leaves(trainable(policy)[0])
    return np.concatenate([np.ravel(leaf) for leaf in leaves]) if leaves else np.zeros(0)
