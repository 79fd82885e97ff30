"""Orders with a fixed cost: whether a place orders, and its likelihood ratio in training.

As for one item (see `item.simulator`), training draws at random whether a place orders, with the
probability given by the policy, and multiplies costs by the likelihood ratio of the draws. Every
place has a ratio. A cost of a place is multiplied by the ratios of only the linked places, since
the other ratios have no effect on the mean of the cost and would only add noise.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from snapo.problem.actions import Actions, Choice, Product
from snapo.problem.smooth import Exact

from .records import SupplyNetwork


def choices(network: SupplyNetwork) -> dict[str, Actions]:
    """Whether to order, for every place where an order has a fixed cost."""
    return {_name(network, i): Choice(2) for i in network.fixed}


def _name(network: SupplyNetwork, i: int) -> str:
    return f"order_{network.sites[i].name}"


class Placed(NamedTuple):
    """The places that order.

    - `orders` [n]: 1 if a place orders, or may do so without a fixed cost.
    - `likelihood` [m]: likelihood ratios of the draws for `network.fixed`, whose value is 1 but
      whose derivative is not 0.
    """

    orders: jax.Array
    likelihood: jax.Array


def placed(
    network: SupplyNetwork,
    actions: Product,
    parts: Mapping[str, Any],
    likelihood,
    remembered,
    normals,
    smooth,
) -> Placed:
    """Whether each site orders: decided by the policy, and in training drawn with the policy's
    probabilities.

    - `parts`: the parts of the action; `likelihood` [m]: the likelihood ratios of earlier periods;
      `normals` [m]: the noise of the draws.
    - `remembered` [m]: the share of `likelihood` that is used, since early draws only add noise to
      this period.
    """
    orders, ratios = jnp.ones(len(network.sites), likelihood.dtype), []
    for k, i in enumerate(network.fixed):
        option, name = parts[_name(network, i)], _name(network, i)
        if not isinstance(smooth, Exact):
            option, ratio = actions[name].draw(option, normals[k])
            ratios.append(ratio)
        orders = orders.at[i].set(option[1])
    if ratios:
        likelihood = jnp.stack(ratios) * (1 + remembered * (likelihood - 1))
    return Placed(orders, likelihood)


class LikelihoodWeights:
    """The likelihood ratios by which outputs are multiplied; their value is 1, but they change the
    derivatives.

    - `likelihood` [m]: the likelihood ratios of this period; None if no order has a fixed cost.
    - `usual_costs` [n]: the usual costs of a period at each place.
    """

    def __init__(self, network: SupplyNetwork, likelihood, usual_costs):
        self.drawn = likelihood is not None
        if self.drawn:
            linked = jnp.asarray(network.linked[:, list(network.fixed)], likelihood.dtype)
            self.place_weights = 1 + linked @ (likelihood - 1)  # [n], of a number of a place
            self.all = 1 + jnp.sum(likelihood - 1)
            self.usual = usual_costs

    def of(self, amounts):
        """[n] amounts of the places, times the ratios of the places linked to each of them."""
        return self.place_weights * amounts if self.drawn else amounts

    def of_all(self, amount):
        """One amount of the whole network, times the ratios of all places."""
        return self.all * amount if self.drawn else amount

    def innovation(self, costs):
        """0, with the derivative of the sum of `of(costs) - costs` [n]; costs count only in their
        deviation from the usual costs, since a smaller factor adds less noise."""
        return jnp.sum((self.place_weights - 1) * (costs - self.usual)) if self.drawn else 0.0
