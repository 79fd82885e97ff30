"""Orders with a cost of their own: whether each place orders, and the likelihood of it in training.

As for one item (see `item.simulator`), training draws at random whether a place orders, with the
probability that the policy gives, and multiplies costs by the likelihood of what was drawn. Every
place has its own likelihood; a cost is multiplied by those of the places that its place is linked
to, for no other has an effect on it, and would only add noise.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from snapo.problem.actions import Actions, Choice, Product
from snapo.problem.smooth import Exact

from .records import SupplyNetwork


def choices(network: SupplyNetwork) -> dict[str, Actions]:
    """Whether to order, of every place where an order has a cost of its own."""
    return {_name(network, i): Choice(2) for i in network.fixed}


def _name(network: SupplyNetwork, i: int) -> str:
    return f"order_{network.sites[i].name}"


class Placed(NamedTuple):
    """Which places order.

    - `orders` [n]: 1 where a place orders, or may at no cost of its own.
    - `likelihood` [m]: 1, with the derivative of what has been drawn, of each of `network.fixed`.
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
    """Whether places order: as the policy says; in training drawn with its probabilities.

    - `parts`: of the action; `likelihood` [m]: of the periods before; `normals` [m].
    - `remembered` [m]: the share of it that counts: what was drawn long ago has no effect on this
      period, only noise.
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
    """The number 1 by which outputs are multiplied, with the derivative of what has led to them.

    - `likelihood` [m]: of this period; None where no order has a cost of its own.
    - `usual_costs` [n]: of a period at each place.
    """

    def __init__(self, network: SupplyNetwork, likelihood, usual_costs):
        self.drawn = likelihood is not None
        if self.drawn:
            linked = jnp.asarray(network.linked[:, list(network.fixed)], likelihood.dtype)
            self.place_weights = 1 + linked @ (likelihood - 1)  # [n], of a number of a place
            self.all = 1 + jnp.sum(likelihood - 1)
            self.usual = usual_costs

    def of(self, amounts):
        """[n] amounts by place."""
        return self.place_weights * amounts if self.drawn else amounts

    def of_all(self, amount):
        """One amount of the whole network."""
        return self.all * amount if self.drawn else amount

    def innovation(self, costs):
        """0, with the derivative of `of(costs) - costs` [n] summed; costs count only as far as they
        are not the usual ones, for the less is multiplied, the less noise there is."""
        return jnp.sum((self.place_weights - 1) * (costs - self.usual)) if self.drawn else 0.0
