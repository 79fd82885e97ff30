"""The trained rule of a network: echelon order-up-to levels that depend on the state."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.policy import Network, Policy

SHARP = 4.0  # of the softplus, as for one item


class EchelonRule(Policy):
    """order = unit softplus(gap + first + network(seen)), each of the n places by itself.

    `gap` is the level of a place's echelon less its position: all goods there, on their way there
    and further down, less demand that waits. An echelon base-stock rule is optimal on a line
    (Clark and Scarf, 1960).
    """

    network: Network | None
    first: Float[Array, " n"]

    def __init__(self, places: int, features: int, *, key, hidden=(32, 32), plain: bool = False):
        self.first = jnp.zeros(places, jnp.float32)
        widths = (features - places, *hidden, places)
        self.network = None if plain else Network(widths, key=key)

    def __call__(self, observation, smooth):
        n = self.first.shape[0]
        gap, unit = observation[:n], observation[n : 2 * n]
        raw = gap + self.first
        if self.network is not None:
            raw = raw + self.network(jnp.concatenate([gap, observation[2 * n :]]))
            return unit * jax.nn.softplus(SHARP * raw) / SHARP
        return unit * smooth.positive_part(raw)
