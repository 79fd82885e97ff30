"""The most that an objective of the funding ratio can gain at a price: sup over F of u(F) - z F."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array

from snapo.problem.objective import ExpectedUtility, Mean, Objective

Conjugate = Callable[[Array], Array]


IN_MONEY = "assets"  # the output that is not a share of the liability


def conjugate(objective: Objective, start: float = 1.0) -> Conjugate:
    """The conjugate as a function of z > 0, for an objective that increases in the final assets.

    F >= 0 is the final funding ratio, or the final assets; `start` the funding ratio now.

    **Raises:** `ValueError` for any other objective, with a list of the allowed ones.
    """
    if isinstance(objective, ExpectedUtility) and objective.output in ("funding_ratio", IN_MONEY):
        return _of_power(objective.utility)
    if isinstance(objective, Mean) and objective.output == "log_relative":
        return lambda z: -jnp.log(z * start) - 1
    if isinstance(objective, Mean) and objective.output == "surplus_ratio":
        return lambda z: jnp.maximum(-z, -1.0)
    raise ValueError(
        'a fund is bounded from above for a utility ("crra") of funding_ratio or assets, and for'
        " the mean of log_relative or of surplus_ratio"
    )


def _of_power(utility) -> Conjugate:
    def gained(z: Array) -> Array:
        # u'(F + w) = z; no ratio is below zero.
        best = jnp.maximum(z ** (-1 / utility.risk_aversion), utility.wealth)
        if utility.risk_aversion == 1:
            gained = jnp.log(best)
        else:
            gained = best ** (1 - utility.risk_aversion) / (1 - utility.risk_aversion)
        return gained - z * (best - utility.wealth)

    return gained
