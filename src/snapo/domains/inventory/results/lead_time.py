"""A period of lead time less, and one more: each trained anew, on the same paths."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from snapo.solver import statistics
from snapo.solver.evaluate import worth_of_groups
from snapo.solver.solve import solve
from snapo.study.study import Part, Setup, StudyRun

from ..item.records import InventoryCase
from ..network.records import NetworkCase
from ..network.setup import make_setup as make_network
from ..network.setup import network_of
from ..read.tables import LONGEST_LEAD
from ..setup import case_of, make_setup

PATHS = 16384  # at most, of either value
STEPS = 200  # at most, of either training

Other = tuple[str, int, int, Callable[[], Setup]]  # place, lead time, the other one, the case ready


def of_item(run: StudyRun) -> dict[str, Any]:
    """ "lead_time_change": one row per other lead time, the change of the result and its error."""
    case, engine = case_of(run.setup), run.setup.engines.name
    lead = case.item.lead
    others = [
        ("", lead, lead + way, lambda way=way: make_setup(with_lead(case, lead + way), engine))  # pyright: ignore
        for way in (-1, 1)
    ]
    return _changes(run, others)


def of_network(run: StudyRun) -> dict[str, Any]:
    """The same for every place by itself, with its name in "place"."""
    case, engine = network_of(run.setup), run.setup.engines.name
    others = [
        (place.name, place.lead, place.lead + way,
         lambda i=i, way=way: make_network(with_lead_at(case, i, way), engine))  # pyright: ignore
        for i, place in enumerate(case.places)
        for way in (-1, 1)
    ]  # fmt: skip
    return _changes(run, others)


LEAD_TIME = Part("lead time", of_item, needs=("training",))
LEAD_TIMES = Part("lead time", of_network, needs=("training",))


def with_lead(case: InventoryCase, lead: int) -> InventoryCase:
    """The case with another lead time and its usual start; the horizon stays."""
    return replace(case, item=replace(case.item, lead=lead, coming=None))


def with_lead_at(case: NetworkCase, place: int, more: int) -> NetworkCase:
    """The case with another lead time of one place; the horizon stays."""
    places = list(case.places)
    places[place] = replace(places[place], lead=places[place].lead + more)
    return replace(case, places=tuple(places))


def _changes(run: StudyRun, others: Iterable[Other]) -> dict[str, Any]:
    rows = []
    for place, lead, other, made in others:
        if not 0 <= other <= LONGEST_LEAD:
            continue
        change = _change(run, made())
        rows.append(
            {"place": place, "lead": other, "change": change.value,
             "standard_error": change.standard_error}
        )  # fmt: skip
        where = f" of {place}" if place else ""
        run.tell(f"lead time {other}{where}: {change.value:+,.4g} to that of {lead}")
    return {"lead_time_change": rows}


def _change(run: StudyRun, other: Setup) -> statistics.Sampled:
    setup = run.setup
    paths = min(PATHS, setup.evaluation.paths)
    evaluation = replace(
        setup.evaluation, paths=paths, sensitivity_paths=0, smooth_paths=0, judge_paths=0
    )
    training = replace(setup.training, steps=min(STEPS, setup.training.steps))
    solved = solve(
        other.problem,
        policy=other.policy,
        training=training,
        evaluation=evaluation,
        engine=other.engines,
    )
    objective, source = setup.problem.objective, setup.problem.sources.evaluation
    found = worth_of_groups(objective, solved.totals, source)
    totals = {
        name: total[: len(solved.totals[name])] for name, total in run.solution.totals.items()
    }
    return statistics.of_shares(found - worth_of_groups(objective, totals, source))
