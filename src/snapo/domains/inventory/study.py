"""The study of an item or a network: the parts of a run, and the headline of its result."""

from typing import Any

from snapo.case.error import CaseError
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import profile
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.study import Part, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .chapters.about import about
from .chapters.baselines import BASELINES
from .chapters.lead_time import LEAD_TIME
from .chapters.levels import LEVELS, today
from .chapters.places import PLACES, network_tables, service_and_places
from .chapters.service import SERVICE, live_tables
from .item.records import InventoryCase
from .network.records import NetworkCase
from .setup import AnyCase, make_setup, setup_at, simulator_of


def lines(case: AnyCase) -> list[str]:
    """The case in a few lines: nothing is trained."""
    describe = _network_lines if isinstance(case, NetworkCase) else _item_lines
    inputs = case.inputs()
    numbers = sum(entry.value.size for entry in inputs.values())
    last = f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity"
    return [*describe(case), last]  # pyright: ignore[reportArgumentType]


def _item_lines(case: InventoryCase) -> list[str]:
    item = case.item
    unmet = "lost" if item.lost else "delivered later"
    integers = "whole" if item.integer else "any"
    problem = Problem(simulator_of(case), case.inputs(), Mean("result"))
    level = float(problem.schedule.steps["level"][case.warm_up])
    return [
        f"{case.title}: {_periods(case)}",
        f"demand of a {case.period}: {case.demand.describe()}; without stock it is {unmet}",
        f"an order arrives after {item.lead_time} {case.period}s; {integers} numbers of "
        f"{case.unit}s",
        f"base-stock level to start from: {level:,.4g} {case.unit}s",
    ]


def _network_lines(case: NetworkCase) -> list[str]:
    sites = case.network.sites
    rows = [f"{case.title}: {len(sites)} places, {_periods(case)}"]
    customers = dict(zip(case.network.sellers, zip(case.demands, case.seasons)))
    for i, site in enumerate(sites):
        supplier = "outside" if site.supplier is None else sites[site.supplier].name
        row = f"{site.name}: from {supplier} in {site.lead_time} {case.period}s"
        if i in customers:
            demand, season = customers[i]
            row += f"; demand {demand.describe()}"
            row += f", a season of {len(season.values)} {case.period}s" if season else ""
        rows.append(row)
    if (ordering := case.ordering) is not None:
        rows += [
            f"an order of {name} costs {cost:,.4g} {ordering.unit}, whatever its size"
            for name, cost in zip(ordering.labels, ordering.values)
        ]
    if (moving := case.transshipment) is not None:
        rows += [
            f"stores that send one another goods: {pool}; {cost:,.4g} {moving.unit}"
            for pool, cost in zip(moving.labels, moving.values)
        ]
    return [
        *rows,
        f"orders are {'whole' if case.network.integer else 'any'} numbers of {case.unit}s",
    ]


def _periods(case: AnyCase) -> str:
    after = f", after {case.warm_up} that do not count" if case.warm_up else ""
    return f"{case.periods} {case.period}s{after}"


def study(case: AnyCase, options: Options) -> Study:
    """Training, service and costs, an item's rule, other rules, moves, lead time, outputs."""
    if options.reference:
        allowed = "an inventory has no references to compute; its baselines are in every run"
        raise CaseError("--reference", "", None, allowed)
    is_network, setup = isinstance(case, NetworkCase), make_setup(case, options.engine)
    if is_network:
        own_parts = [Part(PLACES.name, service_and_places, PLACES.needs)]
    else:
        own_parts = [SERVICE.part, LEVELS.part]
    parts = [
        TRAINING,
        *own_parts,
        BASELINES.part,
        MOVES.part,
        *([LEAD_TIME.part] if case.other_leads else []),
        DISTRIBUTION.part,
        profile(without=("likelihood",) if is_network else ("likelihood", "missed")).part,
        CERTIFICATE.part,
    ]
    return Study(
        "inventory",
        about(case),
        tuple(parts),
        _result,
        lambda: setup,
        setup_at=setup_at,
        today=None if is_network else today,
        inputs=lambda other: other.inputs(),
        live_tables=network_tables if is_network else live_tables,
    )


def _result(run: StudyRun) -> dict[str, Any]:
    """The headline: the value of the trained rule, and those of the classical ones."""
    results = BASELINES.of(run)
    rules = results.rivals[1:] if results else ()
    # A non-finite difference is None in the files of a run.
    lead_time = [
        (x.rule, -x.difference, x.difference_error) for x in rules if x.difference is not None
    ]
    return trained(run, {rule.rule: rule.value for rule in rules}, lead_time)
