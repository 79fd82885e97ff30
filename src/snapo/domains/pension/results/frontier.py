"""The efficient frontier: what contributions buy, from a sweep of a mixture's weight.

For shares s from 0 to 1 the policy is trained on (1 - s) CVaR of min(F - 1, 0) at the horizon
less s times the present value of contributions over the liability of today, each time from the
policy before; all are measured on the same fresh paths.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.policy import Policy
from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import estimate, path_totals
from snapo.solver.solution import Solution
from snapo.solver.train import begin, train

from ..records.case import Frontier

if TYPE_CHECKING:
    from ..run import Problem

TAIL = 50  # paths that the tail of a training batch must hold: a smaller one is biased


def frontier(
    problem: "Problem",
    solution: Solution,
    source: Scenarios,
    progress: Callable[[str], None],
) -> dict[str, Any] | None:
    """Points of the sweep and the learned policy beside them; None where none was asked for.

    Of each point the mean present value of contributions (money) and the CVaR of the shortfall
    (a ratio, at most 0), with standard errors; `efficient`: no other point has less of both.
    """
    asked = problem.case.frontier
    if asked is None:
        return None
    points = []
    policy = solution.policy
    for share in np.linspace(0.0, 1.0, asked.points):
        progress(f"frontier: contributions weigh {share:.0%}")
        policy = _trained(problem, policy, _mixture(problem, asked, share), asked)
        given = (problem.engines.evaluate, problem.simulator, policy, problem.schedule, source)
        totals = path_totals(*given, problem.evaluation.paths, Exact())
        points.append({"share": share} | _measured(totals, source, asked.level))
    for each in points:
        each["efficient"] = not any(_better(other, each) for other in points)
    own = {name: np.asarray(total) for name, total in solution.totals.items()}
    learned = _measured(own, source, asked.level)
    return {"level": asked.level, "points": points, "learned": learned}


def _mixture(problem: "Problem", asked: Frontier, share: float) -> Objective:
    scale = float(problem.schedule.constants.liability)
    tail = (1 - share) * CVaR("surplus_ratio", asked.level)
    return tail - share / scale * Mean("pv_contribution")


def _trained(problem: "Problem", start: Policy, goal: Objective, asked: Frontier) -> Policy:
    from ..run import supplied

    paths = max(problem.training.paths, 2 * round(TAIL / (1 - asked.level) / 2))
    training = replace(problem.training, steps=asked.steps, paths=paths)
    given = (problem.simulator, problem.schedule, begin(start, training), goal, training)
    ready_made = supplied(problem.case, "training")
    return train(*given, problem.engines.train, supplied=ready_made).best


def _measured(totals: dict[str, np.ndarray], source: Scenarios, level: float) -> dict[str, float]:
    paid = estimate(Mean("pv_contribution"), totals, source)
    short = estimate(CVaR("surplus_ratio", level), totals, source)
    final = totals["funding_ratio"]
    return {
        "contributions": paid.value,
        "contributions_error": paid.standard_error,
        "cvar": short.value,
        "cvar_error": short.standard_error,
        "median": float(np.median(final)),
        "underfunded": float((final < 1).mean()),
    }


def _better(one: dict[str, float], other: dict[str, float]) -> bool:
    """Whether `one` asks for less and leaves less of a shortfall."""
    return one["contributions"] < other["contributions"] and one["cvar"] > other["cvar"]
