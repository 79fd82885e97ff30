"""The trained rule of a network: echelon order-up-to levels that depend on the state."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Actions
from snapo.problem.policy import Network, Policy

from .records import NetworkCase

SHARP = 4.0  # of the softplus, as for one item
KEPT = -0.5  # deviations: a store holds back little at first


class EchelonRule(Policy):
    """order = unit softplus(gap + first + network(seen)), each of the n places by itself.

    `gap` is the level of a place's echelon less its position: all goods there, on their way there
    and further down, less demand that waits. An echelon base-stock rule is optimal on a line
    (Clark and Scarf, 1960). What stores of a pool hold back, or their bands, are
    unit softplus(kept + network(seen)), and the shift of their balance is unit network(seen).

    - `movers`: the places of what is held back and of the bands, in the order of the action;
      `shifts` of them, the last ones, have a shift.
    """

    network: Network | None
    first: Float[Array, " n"]
    kept: Float[Array, " movers"]
    movers: tuple[int, ...]
    shifts: int
    action: Actions

    def __init__(
        self,
        case: NetworkCase,
        action: Actions,
        features: int,
        *,
        key,
        hidden: tuple[int, ...] = (32, 32),
        plain: bool = False,
    ):
        places, before = len(case.places), case.moving(True)
        self.movers, self.shifts = case.moving(False) + before, len(before)
        self.action = action
        self.first = jnp.zeros(places, jnp.float32)
        self.kept = jnp.full(len(self.movers), 0.0 if plain else KEPT, jnp.float32)
        widths = (features - places, *hidden, action.size)
        self.network = None if plain else Network(widths, key=key)

    def __call__(self, observation, smooth):
        n = self.first.shape[0]
        gap, unit = observation[:n], observation[n : 2 * n]
        raw = jnp.concatenate([gap + self.first, self.kept])
        units = unit[np.array([*range(n), *self.movers], int)]
        last = units[units.shape[0] - self.shifts :]
        if self.network is None:
            amounts, shift = smooth.positive_part(raw), jnp.zeros_like(last)
        else:
            found = self.network(jnp.concatenate([gap, observation[2 * n :]]))
            amounts = jax.nn.softplus(SHARP * (raw + found[: raw.shape[0]])) / SHARP
            shift = last * found[raw.shape[0] :]
        return self.action.settle(jnp.concatenate([units * amounts, shift]), smooth)
