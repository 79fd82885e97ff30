"""Policies map an observation to an action: networks, residuals, and the base class.

A policy is an `eqx.Module` with `policy(observation, smooth) -> action` and the action in the
simulator's fixed set; `policies.composed.Plain` makes one of any module. Baselines are policies
that replace the network.

A policy can be a recipe: `MLP(hidden=(64, 64))` has no numbers yet. `policy.for_problem` makes
the policy for a simulator's actions and features; `snapo.solve` does so with the training's seed.
"""

import abc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .actions import Actions
from .carry.save import load, reduced, save
from .inputs import Frozen
from .quickly import compiled_sooner
from .simulator import Interface
from .smooth import EXACT, Exact, Smooth


class Policy(eqx.Module):
    """One decision rule. Actions must be in the simulator's fixed action set."""

    @abc.abstractmethod
    def __call__(
        self, observation: ArrayLike | Sequence[float], smooth: Smooth | Exact = EXACT
    ) -> Float[Array, " size"]:
        """The action [size] at one observation [features], an array or a list of numbers.

        The action is that of the exact simulator: whole numbers, stop or continue, one option. With
        `Smooth(temperature)` it is the action of training.
        """

    def for_problem(self, interface: Interface, key) -> "Policy":
        """The policy for this action set and number of features: itself, unless it is a recipe.

        `interface` is `simulator.interface(schedule)`; initial weights are drawn with `key`.
        """
        return self

    @property
    def simplest(self) -> "Policy":
        """A policy with the same decisions that takes less time, for paths that are only valued."""
        return self

    def save(self, file: Path | str) -> None:
        """Writes the policy to a self-describing .npz file, for `snapo.load_policy`.

        **Raises:** `PolicyFileError`, a `ValueError`, for a user-defined class, since the file
        contains no code.
        """
        save(self, file, features(self))

    def __reduce__(self):
        return reduced(self)


def as_observation(values: ArrayLike | Sequence[float]) -> Float[Array, " features"]:
    """An observation as an array of floating numbers."""
    result = jnp.asarray(values)
    return result if jnp.issubdtype(result.dtype, jnp.floating) else result.astype(jnp.float32)


class Network(eqx.Module):
    """A fully connected network with float32 weights. `widths` are the numbers of features, of
    units in each hidden layer, and of outputs.

    The last layer starts small (its weights divided by 100), so that a policy starts near the
    middle of its range and a residual starts at its base.
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    activation: Callable = eqx.field(static=True)

    def __init__(self, widths, *, key, activation: Callable = jax.nn.silu):
        self.weights = _weights(key, list(zip(widths[1:], widths[:-1])))
        self.biases = [jnp.zeros(out, jnp.float32) for out in widths[1:]]
        self.activation = activation

    def __reduce__(self):
        return reduced(self)

    def __call__(self, x: Float[Array, " features"]) -> Float[Array, " outputs"]:
        for weight, bias in zip(self.weights[:-1], self.biases[:-1]):
            x = self.activation(weight @ x + bias)
        return self.weights[-1] @ x + self.biases[-1]


NetworkPolicy = TypeVar("NetworkPolicy", bound=Policy)


def with_idle_network(policy: NetworkPolicy) -> NetworkPolicy:
    """The policy whose `network` adds nothing: its last layer is zero."""

    def last(policy: Any):
        return policy.network.weights[-1], policy.network.biases[-1]

    return eqx.tree_at(last, policy, tuple(jnp.zeros_like(item) for item in last(policy)))


def without_idle_network(policy: NetworkPolicy) -> NetworkPolicy:
    """The policy with None instead of a `network` whose last layer, and so its output, is zero."""
    network = getattr(policy, "network")  # noqa: B009, of kinds of policies that have one
    if network is None:
        return policy
    last = network.weights[-1], network.biases[-1]
    if any(np.asarray(item).any() for item in last):
        return policy
    return eqx.tree_at(lambda x: x.network, policy, None)


@compiled_sooner
def _weights(key, shapes) -> list[Array]:
    keys = jax.random.split(key, len(shapes))
    drawn = [
        jax.random.normal(k, shape, jnp.float32) / jnp.sqrt(jnp.float32(shape[1]))
        for k, shape in zip(keys, shapes)
    ]
    return [*drawn[:-1], drawn[-1] / 100]


class MLP(Policy):
    """A network whose outputs are squashed into the action set (see `Box`, `Choice`, …).

    `MLP(action, features, key=key)` is a network. `MLP(hidden=(64, 64))` is a recipe: `solve`
    creates the network for the simulator's actions and features. Default of `hidden`: see `widths`.
    """

    network: Network | None
    action: Actions | None
    hidden: tuple[int, ...] | None = eqx.field(static=True)
    activation: Callable = eqx.field(static=True)

    def __init__(
        self,
        action: Actions | None = None,
        features: int | None = None,
        *,
        key=None,
        hidden: tuple[int, ...] | None = None,
        activation: Callable = jax.nn.silu,
    ):
        if hidden is None and action is not None:
            hidden = widths(action)
        self.hidden = None if hidden is None else tuple(hidden)
        self.activation, self.action = activation, action
        self.network = _network(self, action, features, key)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        network, action = _made(self)
        return action.squash(network(observation), smooth)

    def for_problem(self, interface: Interface, key) -> "MLP":
        if self.network is not None:
            return _fitting(self, self.network, interface)
        return MLP(
            interface.action,
            interface.features,
            key=key,
            hidden=self.hidden,
            activation=self.activation,
        )


def widths(action: Actions) -> tuple[int, int]:
    """The widths of two hidden layers: four units for each number that is decided, rounded up to a
    power of two, from 32 to 128.

    >>> widths(snapo.Box(0.0, 1.0)), widths(snapo.Box(0.0, 1.0, size=24))
    ((32, 32), (128, 128))
    """
    width = 32
    while width < min(128, 4 * action.size):
        width *= 2
    return width, width


class Residual(Policy):
    """A base rule plus `scale` times a network, kept inside the action set.

    For a `Box` the sum is clipped (smoothly in training), for a `Simplex` the network shifts the
    logarithms of the base's shares. The base is not trained. Without action set, features and key
    it is a recipe, like `MLP`; its base may be one too. Default of `hidden`: see `widths`.
    """

    base: Frozen
    network: Network | None
    action: Actions | None
    scale: float = eqx.field(static=True)
    hidden: tuple[int, ...] | None = eqx.field(static=True)
    activation: Callable = eqx.field(static=True)

    def __init__(
        self,
        base: Policy,
        action: Actions | None = None,
        features: int | None = None,
        *,
        key=None,
        scale: float = 1.0,
        hidden: tuple[int, ...] | None = None,
        activation: Callable = jax.nn.silu,
    ):
        without_memory(base, "Residual")
        if hidden is None and action is not None:
            hidden = widths(action)
        self.base, self.scale = Frozen(base), scale
        self.hidden = None if hidden is None else tuple(hidden)
        self.activation, self.action = activation, action
        self.network = _network(self, action, features, key)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        network, action = _made(self)
        correction = self.scale * network(observation)
        return action.near(self.base.array(observation, smooth), correction, smooth)

    def for_problem(self, interface: Interface, key) -> "Residual":
        if self.network is not None:
            return _fitting(self, self.network, interface)
        return Residual(
            self.base.array.for_problem(interface, key),
            interface.action,
            interface.features,
            key=key,
            scale=self.scale,
            hidden=self.hidden,
            activation=self.activation,
        )


def without_memory(policy: Policy, where: str) -> None:
    """Refuses a policy with memory (see `memory.py`) inside one that does not support it."""
    if hasattr(policy, "decide"):
        message = "has a memory, and must not be part of another policy"
        raise ValueError(f"{where}: {type(policy).__name__} {message}.")


def _network(policy: MLP | Residual, action, features, key) -> Network | None:
    """The network of a policy; None while it is a recipe."""
    values = [item is not None for item in (action, features, key)]
    if not any(values):
        return None
    if not all(values):
        raise ValueError(
            f"{type(policy).__name__}: specify the action set, the number of features and a key "
            "together, or none of them; solve then adds them."
        )
    assert policy.hidden is not None
    return Network((features, *policy.hidden, action.size), key=key, activation=policy.activation)


def _made(policy: MLP | Residual) -> tuple[Network, Actions]:
    if policy.network is None or policy.action is None:
        raise ValueError(
            f"{type(policy).__name__}: this is a recipe without numbers; make the policy with "
            "for_problem(simulator.interface(schedule), key), as solve does."
        )
    return policy.network, policy.action


def _fitting(policy, network: Network, interface: Interface):
    """The policy itself, if its network has the right numbers of features and actions."""
    values = network.weights[0].shape[1], network.weights[-1].shape[0]
    if values != (interface.features, interface.action.size):
        raise ValueError(
            f"{type(policy).__name__}: it takes {values[0]} features and decides {values[1]} "
            f"numbers; this simulator has {interface.features} and {interface.action.size}."
        )
    return policy


def trainable(policy: Policy) -> tuple[Policy, Policy]:
    """Splits a policy into the trained numbers and the rest (integers, `Frozen` tables)."""
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


def load_policy(file: Path | str) -> Policy:
    """The policy saved by `policy.save(file)`, or policy.npz of a solution or a run; its shape need
    not be known, and nothing is executed.

    **Raises:** `PolicyFileError` if the file is missing or damaged, contains something else, or
    weights of inconsistent sizes.
    """
    return load(file, Policy)


def features(policy: Policy) -> int | None:
    """The number of features that a policy observes, from its weights; None if unknown."""
    gain = getattr(policy, "gain", None)
    if gain is not None:
        return int(gain.shape[1])
    network = getattr(policy, "network", None)
    if not isinstance(network, Network):
        return None
    # A head of a domain takes the first numbers of the observation for itself.
    return int(network.weights[0].shape[1]) + getattr(policy, "head", 0)
