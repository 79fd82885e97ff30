"""The learned model as a simulator: every path follows one network of an ensemble."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.noise import uniform
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth

END_WIDTH = 200.0  # in logits, of the end of an episode, for each unit of temperature

Reward = Callable[[Array, Array, Array], Array]
Over = Callable[[Array], Array]


class Model(Simulator):
    """One path of a learned environment, whose state contains the environment's observation.

    The inputs are those of `inputs_of`: weights of all members, scales, first observations. A path
    follows one member, drawn by its initial noise, so a policy must be good in all members and
    cannot exploit the errors of one member. A path that may have ended continues with a smaller
    weight.
    """

    horizon: int = eqx.field(static=True)
    action: Box
    noise_size: int = eqx.field(static=True)  # one for each observed number
    members: int = eqx.field(static=True)
    can_end: bool = eqx.field(static=True)
    circles: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())
    reward: Reward | None = eqx.field(static=True, default=None)
    over: Over | None = eqx.field(static=True, default=None)
    initial_noise_size: ClassVar[int] = 2

    @property
    def size(self) -> int:
        """The number of entries of an observation."""
        return self.noise_size

    @property
    def may_end(self) -> bool:
        """Whether a path may end before the horizon."""
        return self.can_end or self.over is not None

    def prepare(self, inputs):
        return Schedule(inputs, {"done": jnp.arange(self.horizon) / self.horizon})

    def initial(self, constants, noise):
        starts = constants["starts"]
        member = _drawn(noise[0], self.members)
        start = jnp.take(starts, _drawn(noise[1], starts.shape[0]), axis=0, mode="clip")
        one_hot = (jnp.arange(self.members) == member).astype(starts.dtype)
        return {"seen": start, "member": one_hot, "alive": jnp.ones((), starts.dtype)}

    def observe(self, constants, now, state):
        return (state["seen"] - constants["shift"]) / constants["scale"]

    def step(self, constants, now, state, action, noise, smooth):
        observed = state["seen"]
        features = jnp.concatenate([observed, action])
        prediction = _told(constants["layers"], state["member"], features)
        moved = observed + prediction[: self.size] + constants["spread"] * noise
        low, high = constants["low"], constants["high"]
        after = self._on_circles(smooth.clip(moved, low, high, scale=high - low))
        reward, going = prediction[self.size], jnp.ones_like(state["alive"])
        if self.reward is not None:
            reward = self.reward(observed, action, after)
        if self.over is not None:
            going = 1 - smooth.indicator(self.over(after))
        elif self.can_end:
            going = jax.nn.sigmoid(-prediction[self.size + 2] / _width(smooth))
        if self.reward is None and self.may_end:
            reward = going * reward + (1 - going) * prediction[self.size + 1]
        alive = state["alive"]
        after = {"seen": after, "member": state["member"], "alive": alive * going}
        return after, {"reward": alive * reward}

    def state_scale(self, constants):
        one = jnp.ones_like(constants["scale"][0])
        return {"seen": constants["scale"], "member": jnp.ones(self.members), "alive": one}

    def _on_circles(self, observed: Float[Array, " k"]) -> Float[Array, " k"]:
        """Projects every pair of cosine and sine back onto its circle."""
        numbers = [observed[i] for i in range(self.size)]
        for i, j in self.circles:
            radius = jnp.sqrt(numbers[i] ** 2 + numbers[j] ** 2 + 1e-12)
            numbers[i], numbers[j] = numbers[i] / radius, numbers[j] / radius
        return jnp.stack(numbers) if self.circles else observed


def _drawn(normal: Array, count: int) -> Array:
    """A random number from 0 to count - 1."""
    return jnp.clip(jnp.floor(uniform(normal) * count).astype(jnp.int32), 0, count - 1)


def _told(layers: Any, member: Float[Array, " E"], x: Float[Array, " k_m"]) -> Array:
    """The outputs of one member. The outputs of all members are computed, because that costs less
    than fetching the weights of one."""
    *hidden, (weight, bias) = layers
    for number, (w, b) in enumerate(hidden):
        flow = jnp.einsum("eoi,i->eo", w, x) if not number else jnp.einsum("eoi,ei->eo", w, x)
        x = jnp.tanh(flow + b)
    return jnp.einsum("e,eo->o", member, jnp.einsum("eoi,ei->eo", weight, x) + bias)


def _width(smooth) -> Array | float:
    """The width over which an episode ends, which is learned as a probability; in training the
    width is larger."""
    return 1.0 + END_WIDTH * smooth.temperature if isinstance(smooth, Smooth) else 1.0
