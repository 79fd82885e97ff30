"""Classical rules: a constant, linear feedback, a base stock, a threshold."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..actions import Actions
from ..policy import Policy, as_observation
from ..simulator import Interface
from ..smooth import EXACT, Smooth


class Constant(Policy):
    """Always the same action; `Constant()` starts in the middle of the action set.

    With `action`, as `Constant()` has, the value is projected to that set: rounded, or replaced by
    the option with the largest weight.
    """

    value: Array | None
    action: Actions | None

    def __init__(self, value: ArrayLike | None = None, action: Actions | None = None):
        self.value = None if value is None else jnp.asarray(value)
        self.action = action

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        if self.value is None:
            raise ValueError("Constant: this is a recipe without numbers; specify a value.")
        value = self.value.astype(observation.dtype)
        return value if self.action is None else self.action.settle(value, smooth)

    def for_problem(self, interface: Interface, key) -> "Constant":
        return Constant(_middle(interface), interface.action) if self.value is None else self


class Linear(Policy):
    """Linear feedback: gain @ observation + offset; with `action`, kept inside that set.

    `Linear()` starts with a gain of zero [size, features] in the middle of the action set, and is
    kept inside it.

    >>> rule = snapo.Linear([[2.0, -1.0]], offset=0.5, action=snapo.Box(0.0, 3.0))
    >>> [rule(seen).tolist() for seen in ([0.5, 0.5], [2.0, 0.0])]
    [[1.0], [3.0]]
    """

    gain: Array | None
    offset: Array
    action: Actions | None

    def __init__(
        self,
        gain: ArrayLike | None = None,
        offset: ArrayLike = 0.0,
        action: Actions | None = None,
    ):
        self.gain = None if gain is None else jnp.asarray(gain)
        self.offset, self.action = jnp.asarray(offset), action

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        if self.gain is None:
            raise ValueError("Linear: this is a recipe without numbers; specify a gain.")
        feedback = self.gain @ observation
        if self.action is None:
            return feedback + self.offset
        return self.action.near(self.offset, feedback, smooth)

    def for_problem(self, interface: Interface, key) -> "Linear":
        if self.gain is not None:
            return self
        gain = jnp.zeros((interface.action.size, interface.features), jnp.float32)
        return Linear(gain, _middle(interface), interface.action)


def _middle(interface: Interface) -> Float[Array, " size"]:
    """The action that a network without weights would take."""
    nothing = jnp.zeros(interface.action.size, jnp.float32)
    # Smooth, as in training: the exact middle may be an end.
    return interface.action.squash(nothing, Smooth(np.float32(0.02)))


class BaseStock(Policy):
    """Order up to a level: max(level - position, 0), where the position is an observed number.

    >>> snapo.BaseStock(12.0)([5.0]).tolist()
    [7.0]
    """

    level: Array = eqx.field(converter=jnp.asarray)
    position: int = eqx.field(static=True, default=0)
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        return smooth.positive_part(self.level - observation[self.position], self.scale)[None]


class Threshold(Policy):
    """`above` when the observed number exceeds the threshold, else `below`.

    >>> rule = snapo.Threshold(30.0, [0.0], [1.0])
    >>> [rule([price]).tolist() for price in (29.0, 31.0)]
    [[0.0], [1.0]]
    """

    threshold: Array = eqx.field(converter=jnp.asarray)
    below: Array = eqx.field(converter=jnp.asarray)
    above: Array = eqx.field(converter=jnp.asarray)
    feature: int = eqx.field(static=True, default=0)
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        on = smooth.indicator(observation[self.feature] - self.threshold, self.scale)
        return self.below + on * (self.above - self.below)
