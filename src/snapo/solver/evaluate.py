"""What a policy is worth: path totals on fresh scenarios, and the value with its standard error."""

from typing import Any, NamedTuple

import numpy as np

from snapo.engine import Engine, Xla
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import BLOCKS, Scenarios
from snapo.problem.smooth import Exact

from .adjoint import float64


class Value(NamedTuple):
    """An estimate, the standard error of its mean, and how much the control variates explained.

    `control` is the share of the variance that they removed (0 without any).
    """

    value: float
    standard_error: float
    control: float = 0.0


def evaluate(
    problem: Problem,
    policy: Policy,
    paths: int = 65536,
    *,
    smooth: Any = None,
    engine: Engine | None = None,
) -> Value:
    """The objective of a policy on the problem's evaluation scenarios, exact unless `smooth`."""
    totals = path_totals(problem, policy, paths, smooth=smooth, engine=engine)
    controls = problem.simulator.control_variates()
    return estimate(problem.objective, totals, problem.sources.evaluation, controls)


def path_totals(
    problem: Problem,
    policy: Policy,
    paths: int,
    *,
    smooth: Any = None,
    engine: Engine | None = None,
    source: Scenarios | None = None,
) -> dict[str, np.ndarray]:
    """{output: [paths]} in the order of the path numbers, in chunks of independent blocks.

    On the scenarios of `source`, by default those of the evaluation; as many as there are.
    """
    bound = (engine or Xla(precision="float64")).bind(problem)
    source, smooth = source or problem.sources.evaluation, smooth or Exact()
    paths = source.available(paths)
    totals: dict[str, np.ndarray] = {}
    for block in source.blocks(paths, max(BLOCKS, -(-paths // CHUNK))):
        draws = source.draws(block, problem.simulator)
        for name, total in float64(bound.values(policy, draws, smooth).totals).items():
            totals.setdefault(name, np.full(paths, np.nan))[block] = total
    return totals


def estimate(
    objective: Objective, totals: Totals, scenarios: Scenarios, controls: tuple[str, ...] = ()
) -> Value:
    """The objective on these totals, with the controls' known mean of zero taken out.

    Errors come from independent groups of paths (antithetic pairs, Sobol scrambles).
    """
    plain = worth_of_groups(objective, totals, scenarios)
    mean = worth_of_groups(objective, totals, scenarios, controls)
    spread = mean.std(ddof=1 + len(controls)) if mean.size > 2 else np.nan
    total = plain.std(ddof=1)
    explained = 1 - (spread / total) ** 2 if controls and total > 0 else 0.0
    return Value(float(mean.mean()), float(spread / np.sqrt(mean.size)), float(explained))


def worth_of_groups(
    objective: Objective, totals: Totals, scenarios: Scenarios, controls: tuple[str, ...] = ()
) -> np.ndarray:
    """[groups]: the share of each independent group of paths in the objective; its mean is it.

    The controls' coefficients are found by regression on the groups' means.
    """
    influence = objective.influence(totals)
    groups = scenarios.groups(np.arange(influence.size))
    mean = _group_means(influence, groups)
    if not controls:
        return mean
    design = np.stack([_group_means(np.asarray(totals[name]), groups) for name in controls], 1)
    beta = np.linalg.lstsq(design - design.mean(0), mean - mean.mean(), rcond=None)[0]
    return mean - design @ beta


def _group_means(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    return np.bincount(groups, values) / np.bincount(groups)


CHUNK = 8192  # paths in one call of an engine
