"""Appraised returns: the share of a return that is shown at once, the rest later.

shown' = a r + (1 - a) shown, with a the share that an appraisal takes up in a step.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...records.case import PensionModel


def shown_now(case: PensionModel) -> Array | None:
    """[q] the last returns that appraisals have shown; None in a case without any."""
    count = len(case.assets.smoothed)
    return jnp.zeros(count) if count else None


def appraised(
    case: PensionModel, smoothing: Array, log: Float[Array, " n"], displayed: Array | None
) -> tuple[Float[Array, " n"], Array | None]:
    """Log returns as shown, and the next `displayed`; `smoothing` [q] is a."""
    if displayed is None:
        return log, None
    # A copy: JAX remembers an array of the case in the type it met first, and training is in
    # 32 bits, evaluation in 64.
    smoothed = np.array(case.assets.smoothed)
    displayed = smoothing * log[smoothed] + (1 - smoothing) * displayed
    order = np.arange(len(case.assets.classes))
    order[smoothed] = len(order) + np.arange(len(smoothed))
    return jnp.concatenate([log, displayed])[order], displayed
