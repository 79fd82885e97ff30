"""The optimum of a linear plant without bounds and its derivatives, in closed form."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from .plants.linear import LinearQuadratic
from .plants.plant import MEASURED, Plant
from .riccati import Linear, Riccati, expected_cost, linearised, riccati


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


def solved(plant: Plant, values: Mapping[str, Any]) -> Riccati | None:
    """Gains and costs-to-go of a linear plant without bounds; None for any other."""
    if not isinstance(plant, LinearQuadratic) or "limit" in values["plant"]:
        return None
    return riccati(linearised(plant, values["plant"], values["cost"]), plant.horizon)


def optimum(plant: Plant, values: Mapping[str, Any]) -> float | None:
    """The largest mean reward that any rule can have; None where it is not known."""
    found = solved(plant, values)
    if found is None:
        return None
    start, size = values["start"]["x"], found.P.shape[-1]
    spread = np.zeros((size, size))
    mean = start.get("at", start.get("mean"))
    if "low" in start:
        mean = (start["low"] + start["high"]) / 2
        spread = np.diag((start["high"] - start["low"]) ** 2 / 12)
    if "deviation" in start:
        spread = np.diag(start["deviation"] ** 2)
    shocks = np.zeros((size, size))
    if "x" in values["noise"]:
        given = values["noise"]["x"]
        shocks = given @ np.swapaxes(given, -1, -2)
    best = expected_cost(found, np.asarray(mean), spread, shocks)
    if not plant.measured:
        return -best
    if "low" in start:  # not normal: Kalman's filter is the best linear one alone
        return None
    linear, errors = linearised(plant, values["plant"], values["cost"]), values[MEASURED]["x"]
    return -best - estimation_cost(linear, found, spread, shocks, np.diag(errors**2))
