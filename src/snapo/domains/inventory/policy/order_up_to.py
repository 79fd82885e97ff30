"""The trained rule: order up to a level that depends on the stock and on every outstanding order.

    order = deviation softplus(gap + first + gain · seen + network(seen))

where gap is the base-stock level minus the inventory position; all are in standard deviations of
demand. It starts as the base-stock rule. With a fixed cost per order, an order is placed only if
gap > wait + network(seen). This is an (s, S) rule whose numbers depend on the state.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.actions import Actions, Product
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.smooth import EXACT

HEAD = 2  # numbers of the observation before those of the state: the gap, and the unit
SHARP = 4.0  # of the softplus: an order is 0 from about one deviation below
TRIGGER = 2.0  # scores of "order" by deviation of the gap


class OrderUpTo(Policy):
    """The rule above, with its network.

    - `batch`, `wait`: initial distances of S above and of s below the base-stock level, in standard
      deviations.
    """

    network: Network
    gain: Float[Array, " seen"]
    first: Float[Array, ""]
    wait: Float[Array, ""]
    action: Actions

    def __init__(
        self,
        action: Actions,
        features: int,
        *,
        key,
        batch: float = 0.0,
        wait: float = 0.0,
        hidden: tuple[int, ...] = (32, 32),
    ):
        observed, outputs = features - HEAD + 1, 2 if isinstance(action, Product) else 1
        self.network = Network((observed, *hidden, outputs), key=key)
        self.gain = jnp.zeros(observed, jnp.float32)
        self.first = jnp.asarray(batch, jnp.float32)
        self.wait = jnp.asarray(wait, jnp.float32)
        self.action = action

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        gap, unit = observation[0], observation[1]
        observed = jnp.concatenate([gap[None], observation[HEAD:]])
        network = self.network(observed)
        raw = gap + self.first + self.gain @ observed + network[0]
        size = unit * jax.nn.softplus(SHARP * raw) / SHARP
        if not isinstance(self.action, Product):
            return within(self.action, size, smooth)
        score = TRIGGER * (gap - self.wait + network[1])
        placed = self.action["order"].squash(jnp.stack([jnp.zeros_like(score), score]), smooth)
        return jnp.concatenate([placed, within(self.action["size"], size, smooth)])


def within(action: Actions, size, smooth):
    """[1] the amount, limited to the range from 0 to the largest order, and rounded if orders are
    whole."""
    maximum = float(action.bounds()[1][0])
    cut = smooth.minimum(size, maximum, scale=maximum) if maximum < float("inf") else size
    return action.settle(cut[None], smooth)
