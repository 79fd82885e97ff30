"""The efficient frontier: contributions against the shortfall, from a sweep of a mixture's weight.

For shares s from 0 to 1 the aim is (1 - s) CVaR of min(F - 1, 0) at the horizon less s times the
present value of contributions over the liability of today. The sweep goes up and then down again;
each time a policy is trained from the best one for its aim so far, wherever that one was trained,
and in the end each share takes the best of all. Were aims and points measured on the same paths,
points would be in order for that reason alone: of two policies that each serve their own aim best,
the one for the larger s asks for less. They are chosen on the validation paths and measured on
fresh ones, so that they are in order within their errors.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.objective import CVaR, Mean, Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.solver.evaluate import estimate, path_totals, worth
from snapo.solver.train import begin, train
from snapo.study.study import Setup, StudyRun

from ..records.case import Frontier
from .setup import case_of

TAIL = 50  # paths that the tail of a training batch must hold: a smaller one is biased
CHECKS = 4  # validations in each training: a policy on the way may be better than the last one


class Candidate(NamedTuple):
    """A policy, and its totals on the validation paths."""

    policy: Policy
    totals: Totals


def work(run: StudyRun) -> dict[str, Any]:
    """ "frontier": points of the sweep and the learned policy beside them; None where none was
    asked for.

    Of each point the mean present value of contributions (money) and the CVaR of the shortfall
    (a ratio, at most 0), with standard errors; `efficient`: no other point has less of both.
    """
    asked, setup = case_of(run).frontier, run.setup
    if asked is None:
        return {"frontier": None}
    assert run.solution.policy is not None
    problem, source = setup.problem, setup.problem.sources.evaluation
    shares = np.linspace(0.0, 1.0, asked.points)
    goals = [_mixture(problem, asked, share) for share in shares]
    points = []
    for share, found in zip(shares, _swept(run, goals, asked)):
        paths, engine = setup.evaluation.paths, setup.engines.evaluate
        totals = path_totals(problem, found.policy, paths, engine=engine)
        points.append({"share": share} | _measured(totals, source, asked.level))
    for each in points:
        each["efficient"] = not any(_better(other, each) for other in points)
    own = {name: np.asarray(total) for name, total in run.solution.totals.items()}
    learned = _measured(own, source, asked.level)
    return {"frontier": {"level": asked.level, "points": points, "learned": learned}}


def _swept(run: StudyRun, goals: Sequence[Objective], asked: Frontier) -> list[Candidate]:
    """The best policy for each goal, after the goals were trained for in order and back again."""
    setup, policy = run.setup, run.solution.policy
    assert policy is not None
    known = [_candidate(setup, policy)]
    upward = list(range(len(goals)))
    for goal in (*upward, *upward[-2::-1]):
        run.tell(f"frontier: point {goal + 1} of {len(goals)}")
        start = best(known, goals[goal])
        found = _trained(setup, start.policy, goals[goal], asked)
        known.append(_candidate(setup, found))
    return [best(known, goal) for goal in goals]


def best(known: Sequence[Candidate], goal: Objective) -> Candidate:
    """The candidate that is worth most; the first of equals."""
    values = np.array([worth(goal, each.totals) for each in known])
    return known[int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))]


def _candidate(setup: Setup, policy: Policy) -> Candidate:
    source = setup.problem.sources.validation
    paths = source.available(setup.training.validation_paths)
    engine = setup.engines.evaluate
    totals = path_totals(setup.problem, policy, paths, engine=engine, source=source)
    return Candidate(policy, totals)


def _mixture(problem: Problem, asked: Frontier, share: float) -> Objective:
    scale = float(problem.schedule.constants.liability)
    tail = (1 - share) * CVaR("surplus_ratio", asked.level)
    return tail - share / scale * Mean("pv_contribution")


def _trained(setup: Setup, start: Policy, goal: Objective, asked: Frontier) -> Policy:
    """The best policy along a training that begins where another one ended: at its last
    temperature, and with hardly any warm-up."""
    given = setup.training
    training = replace(
        given,
        steps=asked.steps,
        paths=max(given.paths, 2 * round(TAIL / (1 - asked.level) / 2)),
        warmup=min(given.warmup, asked.steps // 8),
        temperature_start=given.temperature_end,
        exploration=0.0,  # the policy has explored already
        validation_every=max(1, asked.steps // CHECKS),
    )
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
