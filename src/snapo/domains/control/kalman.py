"""What errors of measurement cost at the best: linear-quadratic-Gaussian control in closed form.

The best rule is Riccati's on the mean of the state given all that was measured, which Kalman's
filter finds. To the cost of a state that is known it adds

    sum over t of trace(S_t K_t' (R + B'P_{t+1} B) K_t)

with the covariance S_t of the state at decision t given the measurements up to it (Åström,
Introduction to Stochastic Control Theory, 1970, chapter 8).
"""

import numpy as np
from jaxtyping import Float

from .riccati import Linear, Riccati


def estimation_cost(
    plant: Linear,
    found: Riccati,
    start: Float[np.ndarray, "n n"],
    shocks: Float[np.ndarray, "*T n n"],
    errors: Float[np.ndarray, "n n"],
) -> float:
    """The mean cost that is added by errors of measurement.

    `start`, `shocks`, `errors`: covariances of the first state, of disturbances and of errors; all
    of them normal.
    """
    total, prior = 0.0, start
    every = np.broadcast_to(shocks, found.P[1:].shape)
    for gain, ahead, shock in zip(found.K, found.P[1:], every):
        # Where a state is measured exactly, or known, the sum may have no inverse.
        known = prior - prior @ np.linalg.pinv(prior + errors, hermitian=True) @ prior
        worth = gain.T @ (plant.R + plant.B.T @ ahead @ plant.B) @ gain
        total += float(np.sum(known * worth))
        prior = plant.A @ known @ plant.A.T + shock
    return total
