"""The trained rule beside the classical ones, each with its best numbers, on the same paths."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from snapo.engine import Xla
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, worth, worth_of_groups
from snapo.study.study import Part, Setup, StudyRun

from ..item.estimates import economic_lot, mean_demand, usual_deviation
from ..item.records import InventoryCase
from ..policy.myopic import myopic
from ..policy.rules import Classical
from ..setup import case_of
from .search import search

SEARCH_PATHS = 4096
BESIDE = 1  # the stream of the scenarios on which rules look for their numbers
ENDLESS = 1e6  # units of demand: a level or a cap that never binds
RULES = {
    "base stock": ("above",),
    "capped base stock": ("above", "cap"),
    "constant order": ("cap",),
    "(s, S)": ("above", "reorder"),
}


def work(run: StudyRun) -> dict[str, Any]:
    """ "rivals": one row per rule, the trained one first: its result, the difference to the
    trained one with the paired standard error, and its numbers."""
    setup, case = run.setup, case_of(run.setup)
    problem, source = setup.problem, setup.problem.sources.evaluation
    trained = worth_of_groups(problem.objective, run.solution.totals, source)
    rows = [{"rule": "trained", **_result(trained), "difference": None, "difference_error": None}]
    best: dict[str, float] = {}
    for name in RULES:
        if name == "(s, S)" and not case.item.fixed:
            continue  # the same as base stock
        numbers = best_numbers(setup, name, best)
        best |= numbers if name == "base stock" else {}
        rule = classical(setup, name, numbers)
        paths = run.solution.paths["evaluate"]
        totals = path_totals(problem, rule, paths, engine=setup.engines.evaluate)
        found = worth_of_groups(problem.objective, totals, source)
        paired = statistics.of_shares(found - trained)
        rows.append(_row(name, found, paired, _told(case, problem, numbers)))
    if (rule := myopic_of(setup)) is not None:
        found, own = _first_paths(setup, rule), _first_paths(setup, run.solution.policy)
        rows.append(_row("myopic", found, statistics.of_shares(found - own), {}))
    for row in rows[1:]:
        run.tell(f"{row['rule']}: {row['value']:,.6g}, {row['difference']:+,.3g} to the trained")
    return {"rivals": rows}


def _row(name: str, found: np.ndarray, paired: statistics.Sampled, numbers: dict) -> dict[str, Any]:
    return {
        "rule": name,
        **_result(found),
        "difference": paired.value,
        "difference_error": paired.standard_error,
        "numbers": numbers,
    }


def myopic_of(setup: Setup) -> Policy | None:
    """The myopic rule, where it has no simpler form: lost sales of whole demand, no season.

    Where demand waits it is the base stock at the newsvendor's level.
    """
    case = case_of(setup)
    item, demand = case.item, case.demand
    if item.fixed or case.seasonal:
        return None
    if not item.lost:
        return classical(setup, "base stock", {"above": 0.0})
    if not (demand.integral() and item.whole):
        return None
    chances = demand.chances(demand.values())
    costs = item.cost("holding"), item.cost("shortage")
    return myopic(chances, mean_demand(case), *costs, item.lead, setup.problem.action)


def _first_paths(setup: Setup, policy: Policy | None) -> np.ndarray:
    """Shares of the independent groups of the first paths: of a rule that takes longer."""
    problem, source = setup.problem, setup.problem.sources.evaluation
    assert policy is not None
    paths = min(SEARCH_PATHS, setup.evaluation.paths)
    totals = path_totals(problem, policy, paths, engine=Xla())
    return worth_of_groups(problem.objective, totals, source)


RIVALS = Part("rivals", work, needs=("training",))


def classical(setup: Setup, name: str, numbers: dict[str, float]) -> Classical:
    """One of the rules with its numbers; those that it does not have never bind."""
    endless = ENDLESS * max(1.0, mean_demand(case_of(setup)))
    given = {key: numbers.get(key, endless) for key in ("above", "cap", "reorder")}
    made = {key: jnp.asarray(value, jnp.float32) for key, value in given.items()}
    return Classical(**made, action=setup.problem.action)


def best_numbers(setup: Setup, name: str, known: dict[str, float]) -> dict[str, float]:
    """The best numbers of a rule, found on scenarios beside those of the value.

    - `known`: of the base-stock rule, where others may start.
    """
    case, keys = case_of(setup), RULES[name]
    problem = _beside(setup.problem, setup.training.seed)
    mean, lot, deviation = mean_demand(case), economic_lot(case), usual_deviation(case)
    first = {"above": known.get("above", lot), "cap": 1.5 * mean, "reorder": 0.0}
    if name == "constant order":
        first["cap"] = 0.9 * mean
    elif name == "(s, S)":
        first["above"] = max(lot, known.get("above", 0.0))

    def cost(point: Sequence[float]) -> float:
        if "cap" in keys and point[-1] <= 0:
            return np.inf
        rule = classical(setup, name, dict(zip(keys, point)))
        totals = path_totals(problem, rule, SEARCH_PATHS, engine=setup.engines.evaluate)
        return -worth(problem.objective, totals)

    least = 1.0 if case.item.whole else deviation / 64
    start = [first[key] for key in keys]
    found = search(cost, start, max(least, deviation), least)
    return dict(zip(keys, found))


def _beside(problem: Problem, seed: int) -> Problem:
    """The same problem on other paths."""
    old, other = problem.sources, Pseudo(seed, stream=stream(EVALUATE, BESIDE))
    return replace(problem, sources=Sources(old.training, old.validation, other))


def _result(shares: np.ndarray) -> dict[str, float]:
    found = statistics.of_shares(shares)
    return {"value": found.value, "standard_error": found.standard_error}


def _told(case: InventoryCase, problem: Problem, numbers: dict[str, float]) -> dict[str, float]:
    """The numbers as a planner says them: level S, reorder point s, cap."""
    level, told = float(problem.schedule.steps["level"][case.warm_up]), {}
    if "above" in numbers:
        told["level"] = level + numbers["above"]
    if "reorder" in numbers:
        told["reorder point"] = level + numbers["reorder"]
    if "cap" in numbers:
        told["cap"] = numbers["cap"]
    return told
