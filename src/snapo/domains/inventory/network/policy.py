"""The trained rule of a network: echelon order-up-to levels that depend on the state."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from snapo.problem.actions import Actions, Choice, Integers, Product
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.smooth import EXACT, Exact

from ..policy.order_up_to import TRIGGER
from .records import SupplyNetwork

SHARP = 4.0  # of the softplus, as for one item
KEPT = -0.5  # deviations: a store initially holds back only a small amount


class EchelonRule(Policy):
    """order = unit softplus(gap + first + network(seen)), for each of the n places.

    `gap` is the level of a place's echelon minus its position. The position is all goods at the
    place, on their way to it and further downstream, minus demand that waits. An echelon base-stock
    rule is optimal for places in a line (Clark and Scarf, 1960). An order with a fixed cost is
    placed if gap > wait + network(seen), which is an (s, S) rule of the echelon. The amounts that
    stores of a pool hold back, or the widths of their bands, are unit softplus(kept +
    network(seen)). The shift of their balance is unit network(seen).

    - `batch` [n], `wait` [m]: initial distances in standard deviations: of S above the first level
      of the echelon, and of s below it for each of the m places with a fixed cost.
    - `plain`: whether it is a classical rule, without a network and without empty orders.
    - `movers`: the places that hold back an amount or have a band, in the order of the action; the
      last `shifts` of them have a shift; `fixed`: the m places with a fixed cost.
    """

    network: Network | None
    first: Float[Array, " n"]
    reserve: Float[Array, " movers"]
    wait: Float[Array, " m"]
    movers: tuple[int, ...]
    shifts: int
    fixed: tuple[int, ...]
    action: Actions

    def __init__(
        self,
        supply: SupplyNetwork,
        action: Actions,
        features: int,
        *,
        key,
        batch: ArrayLike = 0.0,
        wait: ArrayLike = 0.0,
        hidden: tuple[int, ...] = (32, 32),
        plain: bool = False,
    ):
        sites, before = len(supply.sites), supply.moving(True)
        self.movers, self.shifts = supply.moving(False) + before, len(before)
        self.fixed, self.action = supply.fixed, action
        self.first = jnp.full(sites, jnp.asarray(batch), jnp.float32)
        self.wait = jnp.full(len(self.fixed), jnp.asarray(wait), jnp.float32)
        self.reserve = jnp.full(len(self.movers), 0.0 if plain else KEPT, jnp.float32)
        # Of the two numbers of a choice the second is scored.
        widths = (features - sites, *hidden, action.size - len(self.fixed))
        self.network = None if plain else Network(widths, key=key)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        n = self.first.shape[0]
        gap, unit = observation[:n], observation[n : 2 * n]
        raw = jnp.concatenate([gap + self.first, self.reserve])
        units = unit[np.array([*range(n), *self.movers], int)]
        last = units[units.shape[0] - self.shifts :]
        above = gap[np.array(self.fixed, int)] - self.wait
        if self.network is None:
            amounts, shift = units * smooth.positive_part(raw), jnp.zeros_like(last)
            above = self._something(above, amounts, smooth)
        else:
            network = self.network(jnp.concatenate([gap, observation[2 * n :]]))
            amounts = raw + network[: raw.shape[0]]
            amounts = units * jax.nn.softplus(SHARP * amounts) / SHARP
            shift = last * network[raw.shape[0] : raw.shape[0] + self.shifts]
            above = above + network[raw.shape[0] + self.shifts :]
        parts = [amounts, shift, *self._choices(TRIGGER * above, smooth)]
        return self.action.settle(jnp.concatenate(parts), smooth)

    def _something(self, above, amounts, smooth):
        """`above`, or a negative number if an order with a fixed cost would have no volume, so that
        no order is placed."""
        if not self.fixed or not isinstance(smooth, Exact):
            return above
        assert isinstance(self.action, Product)
        minimum = 0.5 if isinstance(self.action["order"], Integers) else 0.0
        return jnp.where(amounts[np.array(self.fixed, int)] > minimum, above, -1.0)

    def _choices(self, scores, smooth) -> list[Array]:
        """For each of `fixed`, the choice [2] whether to order, from its score."""
        pairs = jnp.stack([jnp.zeros_like(scores), scores], 1)
        return [Choice(2).squash(pairs[k], smooth) for k in range(len(self.fixed))]
