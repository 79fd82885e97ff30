"""The learned policy against classical ones, each tuned on the same objective and bounds."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...evaluate import path_totals
from ...objective import CRRA, ExpectedUtility, Objective
from ...policy import Policy
from ...scenarios import Scenarios
from ...smooth import Exact
from ...solution import Solution
from ...train import begin, train
from .classical import rivals

if TYPE_CHECKING:
    from .run import Problem

TUNING = 150  # steps that tune a classical policy of a few numbers


class Equivalent(NamedTuple):
    """A utility of the final funding ratio as a sure ratio: `slope` is d ratio / d utility."""

    ratio: float
    slope: float


def equivalent(objective: Objective, utility: float) -> Equivalent | None:
    """The sure final funding ratio that is worth as much; None for other objectives."""
    if not (isinstance(objective, ExpectedUtility) and objective.output == "funding_ratio"):
        return None
    crra: CRRA = objective.utility
    ratio = crra.certainty_equivalent(utility)
    if not math.isfinite(ratio):
        return None
    return Equivalent(ratio, 1 / float(crra.slope(np.array(ratio))))


def compare(
    problem: "Problem",
    solution: Solution,
    source: Scenarios,
    thorough: bool,
    progress: Callable[[str], None],
) -> list[dict[str, Any]]:
    """Value, certainty equivalent and paired difference of every policy, the learned one first.

    Paired: on the same fresh paths; a positive difference is the learned policy's lead, and its
    standard error comes from the differences path by path.
    """
    own = {name: np.asarray(total) for name, total in solution.totals.items()}
    found = [_row(problem, "learned", "Learned policy", own, own, source)]
    names = rivals(problem.case, problem.simulator, problem.schedule)
    for key, (name, policy) in names.items():
        progress(f"tuning {name.lower()}")
        tuned = _tuned(problem, policy, thorough)
        given = (problem.engines.evaluate, problem.simulator, tuned, problem.schedule, source)
        totals = path_totals(*given, problem.evaluation.paths, Exact())
        found.append(_row(problem, key, name, totals, own, source))
    return found


def _tuned(problem: "Problem", policy: Policy, thorough: bool) -> Policy:
    """The best of the policies along a run of training, as for the network."""
    from .run import supplied

    steps = problem.training.steps
    training = replace(problem.training, steps=steps if thorough else min(steps, TUNING))
    given = (problem.simulator, problem.schedule, begin(policy, training), problem.objective)
    return train(
        *given, training, problem.engines.train, supplied=supplied(problem.case, "training")
    ).best


def _row(problem: "Problem", key: str, name: str, totals, own, source: Scenarios) -> dict[str, Any]:
    objective, case = problem.objective, problem.case
    value, mine = objective.value(totals), objective.value(own)
    row: dict[str, Any] = {"key": key, "name": name, "value": value}
    spread = objective.influence(own) - objective.influence(totals)
    error = _error(spread, source)
    row |= {"difference": mine - value, "difference_error": error}
    ratio, best = equivalent(objective, value), equivalent(objective, mine)
    if ratio is not None and best is not None:
        years = case.steps * case.step
        # ln of a sure ratio per year moves by its slope over the ratio for one unit of utility.
        ours = objective.influence(own) * best.slope / best.ratio
        theirs = objective.influence(totals) * ratio.slope / ratio.ratio
        row["equivalent"] = ratio.ratio
        row["lead"] = math.log(best.ratio / ratio.ratio) / years
        row["lead_error"] = _error(ours - theirs, source) / years
    final = np.asarray(totals["funding_ratio"])
    row |= {"median": float(np.median(final)), "p05": float(np.quantile(final, 0.05))}
    row["underfunded"] = float((final < 1).mean())
    row["pv_contribution"] = float(np.mean(totals["pv_contribution"]))
    return row


def _error(values: np.ndarray, source: Scenarios) -> float:
    """The standard error of a mean over independent groups of paths (antithetic pairs)."""
    groups = source.groups(np.arange(values.size))
    means = np.bincount(groups, values) / np.bincount(groups)
    return float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else math.nan
