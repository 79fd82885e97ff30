"""The demand that every place serves, by period and ahead, and the first levels of its echelon."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..demand.base import MEAN
from .estimates import safety_factors
from .inputs import demands, network_inputs
from .records import NetworkCase


class Levels(NamedTuple):
    """Of T periods and n places, all in units of demand.

    - `ahead` [T, n, R]: mean demand that a place serves in a period, and in the R - 1 after it;
      R covers the longest way from outside to a customer.
    - `level` [T, n]: first levels of the echelon: the means of the periods that it covers, and a
      safety stock.
    - `unit` [n]: the standard deviation of the demand that a place serves, `typical` [n] its mean,
      both over the season.
    """

    ahead: jax.Array
    level: jax.Array
    unit: jax.Array
    typical: jax.Array


def levels(case: NetworkCase, inputs: Any, periods: int) -> Levels:
    """Those of the first `periods`; where there is no season, all are alike."""
    reach = jnp.asarray(case.serves[:, case.sellers])
    longest = int(max(case.lead_time_from_outside(i) for i in case.sellers))
    means, spreads, usual, typical = [], [], [], []
    for demand, local in demands(case, inputs):
        factors = season(local, periods + longest)
        means.append(local[MEAN] * factors)
        spreads.append(demand.deviation(local, factors))
        once = local.get("season", jnp.ones(1))
        typical.append(local[MEAN] * once.mean())
        usual.append(demand.deviation(local, once).mean())
    item = np.add.outer(np.arange(periods), np.arange(longest))
    mean = (reach @ jnp.stack(means))[:, item]
    variance = (reach @ jnp.stack(spreads) ** 2)[:, item]
    covered = jnp.asarray(np.arange(longest) < case.cover[:, None], mean.dtype)[:, None]
    safety = jnp.sqrt(jnp.sum(variance * covered, 2))
    level = jnp.sum(mean * covered, 2) + jnp.asarray(safety_factors(case))[:, None] * safety
    unit = jnp.sqrt(reach @ jnp.stack(usual) ** 2)
    return Levels(jnp.swapaxes(mean, 0, 1), level.T, unit, reach @ jnp.stack(typical))


def season(local: dict[str, Any], periods: int) -> jax.Array:
    """[T] factors of a place's demand, of its inputs."""
    factors = jnp.asarray(local.get("season", jnp.ones(1)))
    return factors[np.arange(periods) % len(factors)]


def start(case: NetworkCase) -> tuple[jax.Array, jax.Array]:
    """Stock [n] and arrivals [n, longest lead time] at the start: a fact that moves with no input.

    A place starts with its echelon's level less those of the places that it supplies.
    """
    local = {name: network_input.value for name, network_input in network_inputs(case).items()}
    result = levels(case, local, 1)
    level, lead_time = result.level[0], np.array([position.lead_time for position in case.sites])
    slots = np.arange(max(lead_time)) < lead_time[:, None]
    coming = result.ahead[0, :, : slots.shape[1]] * slots
    stock = level - jnp.asarray(case.supplies) @ level - coming.sum(1)
    stock = jnp.maximum(stock, 0.0)
    return (jnp.round(stock), jnp.round(coming)) if case.integer else (stock, coming)
