"""What a policy is worth: path totals on fresh scenarios, and the value with its standard error."""

from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.scenarios import BLOCKS, Scenarios
from snapo.problem.simulator import Schedule, Simulator

from .adjoint import float64


class Value(NamedTuple):
    """An estimate, the standard error of its mean, and how much the control variates explained.

    `control` is the share of the variance that they removed (0 without any).
    """

    value: float
    standard_error: float
    control: float = 0.0


def path_totals(
    engine: Engine,
    simulator: Simulator,
    policy: Policy,
    schedule: Schedule,
    scenarios: Scenarios,
    paths: int,
    smooth,
) -> dict[str, np.ndarray]:
    """{output: [paths]} in the order of the path numbers, in chunks of independent blocks."""
    totals: dict[str, np.ndarray] = {}
    for block in scenarios.blocks(paths, max(BLOCKS, -(-paths // CHUNK))):
        draws = scenarios.draws(block, simulator)
        part = float64(engine.values(simulator, policy, schedule, draws, smooth).totals)
        for name, total in part.items():
            totals.setdefault(name, np.full(paths, np.nan))[block] = total
    return totals


def estimate(
    objective: Objective, totals: Totals, scenarios: Scenarios, controls: tuple[str, ...] = ()
) -> Value:
    """The objective on these totals, with the controls' known mean of zero taken out.

    Errors come from independent groups of paths (antithetic pairs, Sobol scrambles); the controls'
    coefficients are found by regression on the groups' means.
    """
    influence = objective.influence(totals)
    groups = scenarios.groups(np.arange(influence.size))
    mean = _group_means(influence, groups)
    plain = mean.std(ddof=1)
    if controls:
        design = np.stack([_group_means(np.asarray(totals[name]), groups) for name in controls], 1)
        centred = design - design.mean(0)
        beta = np.linalg.lstsq(centred, mean - mean.mean(), rcond=None)[0]
        mean = mean - design @ beta
    spread = mean.std(ddof=1 + len(controls)) if mean.size > 2 else np.nan
    explained = 1 - (spread / plain) ** 2 if controls and plain > 0 else 0.0
    return Value(float(mean.mean()), float(spread / np.sqrt(mean.size)), float(explained))


def _group_means(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    return np.bincount(groups, values) / np.bincount(groups)


CHUNK = 8192  # paths in one call of an engine
