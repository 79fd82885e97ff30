"""Echelon base stock and echelon (s, S) beside the trained rule of a network."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, worth, worth_of_groups
from snapo.study.study import Part, Setup, StudyRun

from ..results.measured import said
from ..results.search import search
from .estimates import first_batches
from .policy import EchelonRule
from .records import NetworkCase
from .setup import network_of

SEARCH_PATHS = 4096
BESIDE = 1  # the stream of the scenarios on which levels are looked for
FINEST = 1 / 16  # of a level, in deviations of demand
ENDLESS = 1e6  # deviations: nothing is sent, or an order waits for nothing
BAND = 0.5  # deviations: where the search for one begins


class Numbers(NamedTuple):
    """Of a classical rule, all in deviations of the demand that a place serves.

    - `above` [n]: how far its levels lie above those of the simulator.
    - `kept`: the bands of stores; what they hold back after demand is nothing, but for `ENDLESS`.
    - `wait` [m]: how far reorder points lie below the levels of the simulator, of each place where
      an order has a cost of its own; None where it orders whenever it is below its level.
    """

    above: tuple[float, ...]
    kept: float = 0.0
    wait: tuple[float, ...] | None = None


def rivals(run: StudyRun) -> dict[str, Any]:
    """ "rivals": the trained rule; echelon base stock at its first levels, and at the best ones of
    a search on other paths; with costs of an order (s, S) of the echelons; where stores may send
    goods, the best numbers if they send none; differences are paired path by path."""
    setup = run.setup
    problem, paths = setup.problem, run.solution.paths["evaluate"]
    source = problem.sources.evaluation
    trained = worth_of_groups(problem.objective, run.solution.totals, source)
    rows = [{"rule": "trained", **said(statistics.of_shares(trained)),
             "difference": None, "difference_error": None}]  # fmt: skip
    for name, numbers in classical(setup).items():
        rule = echelon_rule(setup, *numbers)
        totals = path_totals(problem, rule, paths, engine=setup.engines.evaluate)
        found = worth_of_groups(problem.objective, totals, source)
        paired = statistics.of_shares(found - trained)
        rows.append({"rule": name, **said(statistics.of_shares(found)),
                     "numbers": _told(setup, numbers), "difference": paired.value,
                     "difference_error": paired.standard_error})  # fmt: skip
        run.tell(f"{name}: {rows[-1]['value']:,.6g}, {paired.value:+,.3g} to the trained rule")
    return {"rivals": rows}


RIVALS = Part("rivals", rivals, needs=("training",))


def classical(setup: Setup) -> dict[str, Numbers]:
    """{name: numbers of the rule}. After demand stores hold nothing back; bands before it are one
    more number of the search."""
    case = network_of(setup)
    first = Numbers((0.0,) * len(case.places), BAND if case.moving(True) else 0.0)
    rules = {"newsvendor levels": first._replace(kept=0.0), "best levels": best(setup, first)}
    name = "best levels"
    if case.fixed:
        batch, wait = first_batches(case)
        first = first._replace(above=_numbers(batch), wait=_numbers(wait))
        name = "(s, S) of echelons"
        rules[name] = best(setup, first)
    if case.pools:
        rules[f"{name}, nothing sent"] = best(setup, first._replace(kept=ENDLESS))
    return rules


def echelon_rule(
    setup: Setup,
    above: Sequence[float],
    kept: float = 0.0,
    wait: Sequence[float] | None = None,
) -> EchelonRule:
    """The rule with these `Numbers`."""
    problem, case = setup.problem, network_of(setup)
    rule = EchelonRule(case, problem.action, problem.features, key=jax.random.key(0), plain=True)
    after = len(case.moving(False))
    keeps = [kept if kept == ENDLESS else 0.0] * after + [kept] * len(case.moving(True))
    waits = [-ENDLESS] * len(case.fixed) if wait is None else wait
    given = tuple(jnp.asarray(each, jnp.float32) for each in (above, keeps, waits))
    return eqx.tree_at(lambda each: (each.first, each.kept, each.wait), rule, given)


def best(setup: Setup, start: Numbers) -> Numbers:
    """The best numbers from these on: levels, reorder points where it has some, and the band where
    there is one to choose."""
    case, old = network_of(setup), setup.problem.sources
    other = Pseudo(setup.training.seed, stream=stream(EVALUATE, BESIDE))
    problem = replace(setup.problem, sources=Sources(old.training, old.validation, other))
    waits, banded = start.wait or (), bool(case.moving(True)) and start.kept != ENDLESS
    n = len(start.above)

    def numbers(point: tuple[float, ...]) -> Numbers:
        kept = point[-1] if banded else start.kept
        wait = point[n : n + len(waits)] if start.wait is not None else None
        return Numbers(point[:n], kept, wait)

    def cost(point: tuple[float, ...]) -> float:
        if banded and point[-1] < 0:
            return np.inf
        rule = echelon_rule(setup, *numbers(point))
        totals = path_totals(problem, rule, SEARCH_PATHS, engine=setup.engines.evaluate)
        return -worth(problem.objective, totals)

    # A level and its reorder point: the lot, and both together.
    pairs = [(i, n + k) for k, i in enumerate(case.fixed)] if waits else []
    first = (*start.above, *waits, *([start.kept] if banded else []))
    return numbers(search(cost, first, 0.5, FINEST, together=pairs))


def levels_told(setup: Setup) -> np.ndarray:
    """[n] the simulator's levels in the first period that counts."""
    schedule = setup.problem.schedule
    if "level" in schedule.constants:
        return np.asarray(schedule.constants["level"], np.float64)
    return np.asarray(schedule.steps["level"][network_of(setup).warm_up], np.float64)


def _numbers(each: np.ndarray) -> tuple[float, ...]:
    return tuple(float(x) for x in each)


def _told(setup: Setup, numbers: Numbers) -> dict[str, float]:
    """The numbers as a planner says them: levels and reorder points, and the band in deviations."""
    case, level = network_of(setup), levels_told(setup)
    unit = np.asarray(setup.problem.schedule.constants["unit"])
    reached = level + np.array(numbers.above) * unit
    told = {place.name: float(each) for place, each in zip(case.places, reached)}
    if numbers.wait is not None:
        for i, wait in zip(case.fixed, numbers.wait):
            told[f"{case.places[i].name} from"] = float(level[i] - wait * unit[i])
    return told | _band(case, numbers)


def _band(case: NetworkCase, numbers: Numbers) -> dict[str, float]:
    return {"band": numbers.kept} if case.moving(True) and numbers.kept != ENDLESS else {}
