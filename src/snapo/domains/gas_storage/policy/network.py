"""The storage policy: a network that prices gas in store, and the flows that follow from it.

The network corrects the guide's marginal value of gas at the end of the day, as a line in the
inventory. Gas is injected as far as it is worth more in store than it costs, and withdrawn as
far as it fetches more than it is worth in store: where the value crosses the price, clipped to
the feasible. That is exact on fast storage too, gives the trigger prices for free, and loses
almost nothing when it is made hard.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.smooth import EXACT

from .observation import HEAD, Economics

CORRECTION = 0.1  # of the mean price: the network's numbers are of order one


class MarginalValue(NamedTuple):
    """Marginal values of gas at the end of the day, in units of the mean forward price: of the
    first and the last unit of the most injection, and of the most withdrawal."""

    first_in: Array
    last_in: Array
    first_out: Array
    last_out: Array


class StoragePolicy(Policy):
    """The guide's marginal value plus a network; the action is (injected, withdrawn) fraction."""

    head: ClassVar[int] = HEAD  # numbers of the observation that the network does not see
    network: Network

    def __init__(
        self, features: int, *, key, hidden: tuple[int, ...] = (32, 32), activation=jax.nn.tanh
    ):
        self.network = Network((features - HEAD, *hidden, 3), key=key, activation=activation)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        return _flows(Economics(*observation[:HEAD]), self.marginal_value(observation), smooth)

    @property
    def value_rule(self) -> "StoragePolicy":
        """The guide alone, by a network that adds nothing: one program runs both."""

        def last(policy: StoragePolicy):
            return policy.network.weights[-1], policy.network.biases[-1]

        return eqx.tree_at(last, self, tuple(jnp.zeros_like(item) for item in last(self)))

    def marginal_value(self, observation) -> MarginalValue:
        """The policy's value of a unit of gas at the end of the day."""
        economics = Economics(*observation[:HEAD])
        level, into, out = CORRECTION * economics.level * self.network(observation[HEAD:])
        return MarginalValue(
            economics.first_in + level,
            economics.last_in + level + into * economics.room_in,
            economics.first_out + level,
            economics.last_out + level + out * economics.room_out,
        )


def _flows(economics: Economics, value: MarginalValue, smooth):
    """Fractions of the free injection and withdrawal that pay."""
    injected = smooth.share(value.first_in - economics.buy, value.last_in - economics.buy)
    withdrawn = smooth.share(economics.sell - value.first_out, economics.sell - value.last_out)
    return jnp.stack([injected, withdrawn])
