"""The classical rules, as policies with one to three numbers each."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.actions import Actions, Product
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT

from .order_up_to import within


class Classical(Policy):
    """Order up to a level, at most a cap, and only from a reorder point down.

    Level and reorder point are given relative to the simulator's own level of the period, so that
    they move with a season.

    - `above`: the level S is that much above; `cap`: the most of one order; `reorder`: an order
      is placed where the inventory position lies below s = level + reorder.

    With an infinite cap and reorder point it is a base-stock rule; with a cap a capped base-stock
    rule (Xin, 2021); with an infinite level and a cap a constant order; with a reorder point an
    (s, S) rule.
    """

    above: Float[Array, ""]
    cap: Float[Array, ""]
    reorder: Float[Array, ""]
    action: Actions

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        gap = observation[0] * observation[1]
        wanted = smooth.positive_part(gap + self.above, observation[1])
        placed = smooth.indicator(gap + self.reorder, observation[1])
        size = smooth.minimum(wanted, self.cap, observation[1])
        if not isinstance(self.action, Product):
            return within(self.action, placed * size, smooth)
        return jnp.concatenate(
            [jnp.stack([1 - placed, placed]), within(self.action["size"], size, smooth)]
        )
