"""The optimum of a linear plant without bounds and its derivatives, in closed form."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .kalman import estimation_cost
from .plants.linear import LinearQuadratic
from .plants.plant import MEASURED, Plant
from .riccati import Riccati, expected_cost, linearised, riccati


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
