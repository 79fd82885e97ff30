"""Service and costs of a network and its places, and echelon base stock beside the trained rule."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, worth, worth_of_groups
from snapo.study.study import Part, Setup, StudyRun

from ..results.measured import Measured, said
from ..results.search import search
from .policy import EchelonRule
from .setup import network_of

SEARCH_PATHS = 4096
BESIDE = 1  # the stream of the scenarios on which levels are looked for
FINEST = 1 / 16  # of a level, in deviations of demand
ENDLESS = 1e6  # deviations: nothing is sent


def service_and_places(run: StudyRun) -> dict[str, Any]:
    """ "service" and "costs" as for one item, and "places": one row per place with its stock and,
    where it sells, its fill rate and demand, in a pool what it sends and receives in a period,
    each with its standard error."""
    case, found = network_of(run.setup), Measured.of(run)
    names = ("holding", "shortage", *(["transshipment"] if case.pools else []))
    costs = [{"name": name, **found.total(name)} for name in names]
    places = []
    for place in case.places:
        row: dict[str, Any] = {"name": place.name, "level": found.total(f"level_{place.name}")}
        row["supplier"] = "" if place.supplier is None else case.places[place.supplier].name
        row["stock"] = found.total(f"stock_{place.name}")
        if place.demand is not None:
            row["demand"] = found.total(f"demand_{place.name}")
            row["fill_rate"] = found.ratio(f"sold_{place.name}", f"demand_{place.name}")
        if f"sent_{place.name}" in found.totals:
            row |= {way: found.total(f"{way}_{place.name}") for way in ("sent", "received")}
        places.append(row)
    return {"service": found.service(), "costs": costs, "places": places}


SERVICE = Part("service", service_and_places, needs=("training",))


def rivals(run: StudyRun) -> dict[str, Any]:
    """ "rivals": the trained rule; echelon base stock at its first levels, at the best ones of a
    search on other paths, and where stores may send goods, at the best ones if they send none;
    differences are paired path by path."""
    setup = run.setup
    problem, paths = setup.problem, run.solution.paths["evaluate"]
    source = problem.sources.evaluation
    trained = worth_of_groups(problem.objective, run.solution.totals, source)
    rows = [{"rule": "trained", **said(statistics.of_shares(trained)),
             "difference": None, "difference_error": None}]  # fmt: skip
    for name, numbers in classical(setup).items():
        totals = path_totals(problem, echelon_rule(setup, *numbers), paths,
                             engine=setup.engines.evaluate)  # fmt: skip
        found = worth_of_groups(problem.objective, totals, source)
        paired = statistics.of_shares(found - trained)
        rows.append({"rule": name, **said(statistics.of_shares(found)),
                     "numbers": _told(setup, *numbers), "difference": paired.value,
                     "difference_error": paired.standard_error})  # fmt: skip
        run.tell(f"{name}: {rows[-1]['value']:,.6g}, {paired.value:+,.3g} to the trained rule")
    return {"rivals": rows}


RIVALS = Part("rivals", rivals, needs=("training",))

Levels = tuple[float, ...]


def classical(setup: Setup) -> dict[str, tuple[Levels, float]]:
    """{name: (levels [n] above the simulator's, what stores keep), both in deviations}.

    After demand stores hold nothing back; bands before it are one more number of the search.
    """
    case = network_of(setup)
    start, banded = (0.0,) * len(case.places), bool(case.moving(True))

    def best(kept: float | None) -> tuple[Levels, float]:
        found = best_numbers(setup, start if kept is not None else (*start, 0.5), kept)
        return (found, kept) if kept is not None else (found[:-1], found[-1])

    rules = {"newsvendor levels": (start, 0.0), "best levels": best(None if banded else 0.0)}
    return rules | ({"best levels, nothing sent": best(ENDLESS)} if case.pools else {})


def echelon_rule(setup: Setup, above: Sequence[float], kept: float = 0.0) -> EchelonRule:
    """Echelon base stock, its levels `above` those of the simulator in deviations.

    - `kept`: the bands of stores, in deviations; what they hold back after demand is nothing,
      but for `ENDLESS`.
    """
    problem, case = setup.problem, network_of(setup)
    rule = EchelonRule(case, problem.action, problem.features, key=jax.random.key(0), plain=True)
    after = len(case.moving(False))
    keeps = [kept if kept == ENDLESS else 0.0] * after + [kept] * len(case.moving(True))
    given = jnp.asarray(above, jnp.float32), jnp.asarray(keeps, jnp.float32)
    return eqx.tree_at(lambda each: (each.first, each.kept), rule, given)


def best_numbers(setup: Setup, start: Levels, kept: float | None = 0.0) -> Levels:
    """The best levels [n] relative to the simulator's, in deviations; where `kept` is None, and
    the best band after them."""
    old = setup.problem.sources
    other = Pseudo(setup.training.seed, stream=stream(EVALUATE, BESIDE))
    problem = replace(setup.problem, sources=Sources(old.training, old.validation, other))

    def cost(numbers: Levels) -> float:
        if kept is not None:
            rule = echelon_rule(setup, numbers, kept)
        elif numbers[-1] < 0:
            return np.inf
        else:
            rule = echelon_rule(setup, numbers[:-1], numbers[-1])
        totals = path_totals(problem, rule, SEARCH_PATHS, engine=setup.engines.evaluate)
        return -worth(problem.objective, totals)

    return search(cost, start, 0.5, FINEST)


def _told(setup: Setup, above: Levels, kept: float) -> dict[str, float]:
    """The numbers as a planner says them: levels, and the band in deviations."""
    case, constants = network_of(setup), setup.problem.schedule.constants
    reached = constants["level"] + np.array(above) * constants["unit"]
    told = {place.name: float(level) for place, level in zip(case.places, reached)}
    return told | ({"band": kept} if case.moving(True) and kept != ENDLESS else {})
