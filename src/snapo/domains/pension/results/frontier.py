"""The efficient frontier: contributions against the shortfall, from a sweep of a mixture's weight.

For shares s from 0 to 1 the policy is trained on (1 - s) CVaR of min(F - 1, 0) at the horizon
less s times the present value of contributions over the liability of today, each time from the
policy before; all are measured on the same fresh paths.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.solver.evaluate import estimate, path_totals
from snapo.solver.train import begin, train
from snapo.study.study import Setup, StudyRun

from ..records.case import Frontier
from .setup import case_of

TAIL = 50  # paths that the tail of a training batch must hold: a smaller one is biased


def work(run: StudyRun) -> dict[str, Any]:
    """ "frontier": points of the sweep and the learned policy beside them; None where none was
    asked for.

    Of each point the mean present value of contributions (money) and the CVaR of the shortfall
    (a ratio, at most 0), with standard errors; `efficient`: no other point has less of both.
    """
    asked, setup = case_of(run).frontier, run.setup
    if asked is None:
        return {"frontier": None}
    points, policy = [], run.solution.policy
    assert policy is not None
    problem, source = setup.problem, setup.problem.sources.evaluation
    for share in np.linspace(0.0, 1.0, asked.points):
        run.tell(f"frontier: contributions weigh {share:.0%}")
        policy = _trained(setup, policy, _mixture(problem, asked, share), asked)
        paths, engine = setup.evaluation.paths, setup.engines.evaluate
        totals = path_totals(problem, policy, paths, engine=engine)
        points.append({"share": share} | _measured(totals, source, asked.level))
    for each in points:
        each["efficient"] = not any(_better(other, each) for other in points)
    own = {name: np.asarray(total) for name, total in run.solution.totals.items()}
    learned = _measured(own, source, asked.level)
    return {"frontier": {"level": asked.level, "points": points, "learned": learned}}


def _mixture(problem: Problem, asked: Frontier, share: float) -> Objective:
    scale = float(problem.schedule.constants.liability)
    tail = (1 - share) * CVaR("surplus_ratio", asked.level)
    return tail - share / scale * Mean("pv_contribution")


def _trained(setup: Setup, start: Policy, goal: Objective, asked: Frontier) -> Policy:
    paths = max(setup.training.paths, 2 * round(TAIL / (1 - asked.level) / 2))
    training = replace(setup.training, steps=asked.steps, paths=paths)
    problem = replace(setup.problem, objective=goal)
    return train(problem, begin(start, training), training, setup.engines.train).best


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
