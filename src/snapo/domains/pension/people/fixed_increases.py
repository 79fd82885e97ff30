"""Fixed increases: promised whatever happens, so that they are part of the payments themselves.

Pensions grow by the same rate at the end of every step that ends on the date of indexation; a
payment of step s is (1 + rate) ** n(s) of the rights of time 0, n(s) the dates before step s.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import PensionCase
from ..records.inputs import use


def due(case: PensionCase, count: int) -> np.ndarray:
    """[count] whether each step ends on the date of indexation; yearly steps always do."""
    if round(1 / case.step) == 1:
        return np.ones(count, bool)
    return (case.start_month + np.arange(count)) % 12 + 1 == case.plan.indexation.month


def grown(case: PensionCase, inputs: dict[str, Any], count: int) -> Float[Array, " count"] | None:
    """[count] what a right of time 0 has grown to in each step; None without fixed increases."""
    rule = case.plan.indexation
    if rule.kind != "fixed" or rule.rate is None:
        return None
    dates = np.concatenate([[0], np.cumsum(due(case, count))[:-1]])
    return (1 + use(inputs, rule.rate)) ** jnp.asarray(dates, float)
