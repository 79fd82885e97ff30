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


def service_and_places(run: StudyRun) -> dict[str, Any]:
    """ "service" and "costs" as for one item, and "places": one row per place with its stock and,
    where it sells, its fill rate and demand, each with its standard error."""
    case, found = network_of(run.setup), Measured.of(run)
    costs = [{"name": name, **found.total(name)} for name in ("holding", "shortage")]
    places = []
    levels = run.setup.problem.schedule.constants["level"]
    for place, level in zip(case.places, levels):
        row: dict[str, Any] = {"name": place.name, "level": float(level)}
        row["supplier"] = "" if place.supplier is None else case.places[place.supplier].name
        row["stock"] = found.total(f"stock_{place.name}")
        if place.demand is not None:
            row["demand"] = found.total(f"demand_{place.name}")
            row["fill_rate"] = found.ratio(f"sold_{place.name}", f"demand_{place.name}")
        places.append(row)
    return {"service": found.service(), "costs": costs, "places": places}


SERVICE = Part("service", service_and_places, needs=("training",))


def rivals(run: StudyRun) -> dict[str, Any]:
    """ "rivals": the trained rule, the echelon base-stock rule at its first levels, and at the best
    ones of a search on other paths; differences paired path by path."""
    setup, case = run.setup, network_of(run.setup)
    problem, paths = setup.problem, run.solution.paths["evaluate"]
    source = problem.sources.evaluation
    trained = worth_of_groups(problem.objective, run.solution.totals, source)
    rows = [{"rule": "trained", **said(statistics.of_shares(trained)),
             "difference": None, "difference_error": None}]  # fmt: skip
    constants = problem.schedule.constants
    start = (0.0,) * len(case.places)
    for name, levels in (("newsvendor levels", start), ("best levels", best_levels(setup, start))):
        rule = echelon_rule(setup, levels)
        totals = path_totals(problem, rule, paths, engine=setup.engines.evaluate)
        found = worth_of_groups(problem.objective, totals, source)
        paired = statistics.of_shares(found - trained)
        reached = constants["level"] + np.array(levels) * constants["unit"]
        told = {place.name: float(level) for place, level in zip(case.places, reached)}
        rows.append({"rule": name, **said(statistics.of_shares(found)), "numbers": told,
                     "difference": paired.value,
                     "difference_error": paired.standard_error})  # fmt: skip
        run.tell(f"{name}: {rows[-1]['value']:,.6g}, {paired.value:+,.3g} to the trained rule")
    return {"rivals": rows}


RIVALS = Part("rivals", rivals, needs=("training",))


def echelon_rule(setup: Setup, above: Sequence[float]) -> EchelonRule:
    """Echelon base stock, its levels `above` those of the simulator in deviations."""
    n, problem = len(above), setup.problem
    rule = EchelonRule(n, problem.features, key=jax.random.key(0), plain=True)
    return eqx.tree_at(lambda each: each.first, rule, jnp.asarray(above, jnp.float32))


def best_levels(setup: Setup, start: Sequence[float]) -> tuple[float, ...]:
    """The best levels [n] relative to the simulator's, in deviations."""
    old = setup.problem.sources
    other = Pseudo(setup.training.seed, stream=stream(EVALUATE, BESIDE))
    problem = replace(setup.problem, sources=Sources(old.training, old.validation, other))

    def cost(above: tuple[float, ...]) -> float:
        rule = echelon_rule(setup, above)
        totals = path_totals(problem, rule, SEARCH_PATHS, engine=setup.engines.evaluate)
        return -worth(problem.objective, totals)

    return search(cost, start, 0.5, FINEST)
