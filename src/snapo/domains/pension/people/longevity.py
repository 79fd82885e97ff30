"""How values respond to the mortality factor of Lee-Carter, to first order in it.

At factor k the hazard at age x is exp(b(x) k) times its table's, so that a life's survival over a
step of hazard h falls by the factor exp(-b h k) to first order. While k_t holds from t on, a
payment is multiplied by exp(-outlook k_t), where outlook is the mean of sum b h over the lives it
depends on, weighted with their payments. As a step passes with k_t, all rights fall
by exp(-decline k_t), decline being the same mean for that step alone, weighted with values.
Differences between the cohorts' fates and terms of second order in k are left out.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import LeeCarter, PensionCase
from ..records.inputs import use
from .cash_flows import Projection, Streams, horizon
from .mortality import accumulate, partner, step_hazards


class Longevity(NamedTuple):
    """`decline` [T+1]: fall of ln value in step t per unit of k. `flow` [T+1, N]: payments of
    rights accrued before t, each times its response to k from t on, at baseline wages."""

    decline: Array
    flow: Array


def longevity(
    case: PensionCase, inputs: dict[str, Any], found: Projection, log_bond: Float[Array, " H"]
) -> Longevity | None:
    """The response at every time; None without a factor, or without members."""
    streams = found.streams
    if case.lee_carter is None or streams is None:
        return None
    steps, count = case.steps, horizon(case)
    response = _response(case, inputs, case.lee_carter, streams)
    growth = use(inputs, case.inflation.real_wage_growth) * case.step
    gained = jnp.exp(growth * jnp.arange(steps)) * streams.accrual
    rights = streams.held[:, None] + accumulate(gained)
    shift = int(case.plan.timing == "arrears")
    at_payment = response[:, shift : count + shift]
    here = response[:, : steps + 1]
    flow = rights.T @ (streams.unit * at_payment) - (rights * here).T @ streams.unit
    value = streams.unit * jnp.exp(log_bond[shift : count + shift])
    ahead = jnp.cumsum(value[:, ::-1], axis=1)[:, ::-1]
    weight = rights[:, 1:] * ahead[:, 1 : steps + 1]
    total = weight.sum(0)
    fall = jnp.sum(weight * (here[:, 1:] - here[:, :-1]), axis=0)
    decline = jnp.where(total > 0, fall / jnp.where(total > 0, total, 1.0), 0.0)
    return Longevity(jnp.append(decline, 0.0), flow)


def _response(
    case: PensionCase, inputs: dict[str, Any], factor: LeeCarter, streams: Streams
) -> Float[Array, "K N+1"]:
    """Sum of b h over the lives of each stream from time 0 to each time."""
    lives, count = streams.lives, horizon(case)
    loading = use(inputs, factor.loading)
    own = (lives.sex, lives.age, count, loading, lives.factor)
    member = accumulate(step_hazards(case, inputs, *own))
    found = jnp.asarray(streams.member[:, None]) * member[streams.group]
    if not np.any(streams.spouse):
        return found
    sex, age = partner(case.plan, lives.sex, lives.age)
    other = accumulate(step_hazards(case, inputs, sex, age, count, loading))
    return found + jnp.asarray(streams.spouse[:, None]) * other[streams.group]
