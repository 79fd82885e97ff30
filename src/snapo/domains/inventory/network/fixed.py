"""Orders with a cost of their own: whether each place orders, and the likelihood of it in training.

As for one item (see `item.simulator`), training draws at random whether a place orders, with the
probability that the policy gives, and multiplies costs by the likelihood of what was drawn. Every
place has its own likelihood; a cost is multiplied by those of the places that its place is linked
to, for no other has an effect on it, and would add noise alone.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from snapo.problem.actions import Actions, Choice, Product
from snapo.problem.smooth import Exact

from .estimates import memory, usual_costs
from .records import NetworkCase


def choices(case: NetworkCase) -> dict[str, Actions]:
    """Whether to order, of every place where an order has a cost of its own."""
    return {_name(case, i): Choice(2) for i in case.fixed}


def _name(case: NetworkCase, i: int) -> str:
    return f"order_{case.sites[i].name}"


class Placed(NamedTuple):
    """Which places order.

    - `orders` [n]: 1 where a place orders, or may at no cost of its own.
    - `likelihood` [m]: 1, with the derivative of what has been drawn, of each of `case.fixed`.
    """

    orders: jax.Array
    likelihood: jax.Array


def placed(
    case: NetworkCase, actions: Product, parts: Mapping[str, Any], likelihood, normals, smooth
) -> Placed:
    """Whether places order: as the policy says; in training drawn with its probabilities.

    - `parts`: of the action; `likelihood` [m]: of the periods before; `normals` [m].
    """
    orders, ratios = jnp.ones(len(case.sites), likelihood.dtype), []
    for k, i in enumerate(case.fixed):
        option, name = parts[_name(case, i)], _name(case, i)
        if not isinstance(smooth, Exact):
            option, ratio = actions[name].draw(option, normals[k])
            ratios.append(ratio)
        orders = orders.at[i].set(option[1])
    if ratios:
        # What was drawn long ago has no effect on this period, only noise.
        selected = jnp.asarray(1 - 1 / memory(case), likelihood.dtype)
        likelihood = jnp.stack(ratios) * (1 + selected * (likelihood - 1))
    return Placed(orders, likelihood)


class LikelihoodWeights:
    """The number 1 by which outputs are multiplied, with the derivative of what has led to them.

    - `likelihood` [m]: of this period; None where no order has a cost of its own.
    """

    def __init__(self, case: NetworkCase, likelihood):
        self.drawn = likelihood is not None
        if self.drawn:
            linked = jnp.asarray(case.linked[:, list(case.fixed)], likelihood.dtype)
            self.mean_weights = 1 + linked @ (likelihood - 1)  # [n], of a number of a place
            self.all = 1 + jnp.sum(likelihood - 1)
            self.usual = jnp.asarray(usual_costs(case), likelihood.dtype)

    def of(self, amounts):
        """[n] amounts by place."""
        return self.mean_weights * amounts if self.drawn else amounts

    def of_all(self, amount):
        """One amount of the whole network."""
        return self.all * amount if self.drawn else amount

    def innovation(self, costs):
        """0, with the derivative of `of(costs) - costs` [n] summed; costs count only as far as they
        are not the usual ones, for the less is multiplied, the less noise there is."""
        return jnp.sum((self.mean_weights - 1) * (costs - self.usual)) if self.drawn else 0.0
