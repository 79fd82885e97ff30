"""Level payments that close a gap to the target: an annuity at the interest of the valuation.

Recovery periods of whole steps follow one another from time 0. At each step the current gap is
divided by the value of 1 a year until the end of its period, at the forward rates of the valuation
today: where assets and liability earn them, payments are level and the gap is closed at the end.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..market.curve import log_bond
from ..records.case import PensionModel
from ..records.inputs import use


def log_discount(case: PensionModel, inputs: dict[str, Any], years: np.ndarray) -> Array:
    """[n] ln of the discount factors of money at times `years` on the basis of the valuation."""
    basis = case.liability
    added = 0.0 if basis.basis == "risk-free" else -use(inputs, basis.rate) * years
    if basis.basis != "fixed":
        return log_bond(case.curve, inputs, years) + added
    if basis.future_indexation == "full":  # a real rate
        added = added + log_bond(case.inflation.break_even, inputs, years)
    return jnp.asarray(added)


def annuity(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " T"] | None:
    """Worth at each step of 1 a year until the end of its recovery period; None without level
    payments."""
    period = case.plan.contribution.level_steps
    if period is None:
        return None
    now = np.arange(case.steps)
    end = now + period - now % period
    discount = jnp.exp(log_discount(case, inputs, np.arange(end[-1] + 1) * case.step))
    paid = jnp.concatenate([jnp.zeros(1), jnp.cumsum(discount)])
    first = 0 if case.plan.timing == "advance" else 1
    return case.step * (paid[end + first] - paid[now + first]) / discount[now]
