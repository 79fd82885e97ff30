"""The study of a case with places."""

from typing import Any

from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import profile
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.study import Part, Study, StudyRun
from snapo.study.training import TRAINING

from ..results.lead_time import LEAD_TIMES
from ..results.measured import Measured
from ..results.shown import service_and_costs
from ..told import about, result, without_references
from .inputs import network_inputs
from .records import NetworkCase
from .rivals import RIVALS
from .setup import make_setup, moved_setup, network_of
from .simulator import AVERAGES, OUTPUTS


def service_and_places(run: StudyRun) -> dict[str, Any]:
    """ "service" and "costs" as for one item, and "places": one row per place with its stock, the
    level up to which it orders and, where it sells, its fill rate and demand, in a pool what it
    sends and receives in a period, with a cost of an order the number of its orders in a period
    and their size; each with its standard error."""
    case, found = network_of(run.setup), Measured.of(run)
    more = [(case.ordering, "ordering"), (case.transshipment, "transshipment")]
    names = ["holding", "shortage", *(name for given, name in more if given is not None)]
    costs = [{"name": name, **found.total(name)} for name in names]
    places = []
    for place in case.places:
        row: dict[str, Any] = {"name": place.name, "level": found.total(f"level_{place.name}")}
        row["supplier"] = "" if place.supplier is None else case.places[place.supplier].name
        row["stock"] = found.total(f"stock_{place.name}")
        if place.fixed:
            orders = f"orders_{place.name}"
            row["level"] = found.ratio(f"level_{place.name}", orders)
            row["orders"] = found.total(orders)
            row["order_size"] = found.ratio(f"ordered_{place.name}", orders)
        if place.demand is not None:
            row["demand"] = found.total(f"demand_{place.name}")
            row["fill_rate"] = found.ratio(f"sold_{place.name}", f"demand_{place.name}")
        if f"sent_{place.name}" in found.totals:
            row |= {way: found.total(f"{way}_{place.name}") for way in ("sent", "received")}
        places.append(row)
    return {"service": found.service(), "costs": costs, "places": places}


SERVICE = Part("service", service_and_places, needs=("training",))


def lines(case: NetworkCase) -> list[str]:
    """The case in a few lines: nothing is trained."""
    count, numbers = len(case.places), network_inputs(case)
    after = f", after {case.warm_up} that do not count" if case.warm_up else ""
    found = [f"{case.title}: {count} places, {case.periods} {case.period}s{after}"]
    for place in case.places:
        supplier = "outside" if place.supplier is None else case.places[place.supplier].name
        sells = f"; demand {place.demand.words()}" if place.demand is not None else ""
        season = f", a season of {len(place.season.values)} {case.period}s" if place.season else ""
        found.append(f"{place.name}: from {supplier} in {place.lead} {case.period}s{sells}{season}")
    if (ordering := case.ordering) is not None:
        found += [
            f"an order of {name} costs {cost:,.4g} {ordering.unit}, whatever its size"
            for name, cost in zip(ordering.labels, ordering.values)
        ]
    if (moving := case.transshipment) is not None:
        found += [
            f"stores that send one another goods: {pool}; {cost:,.4g} {moving.unit}"
            for pool, cost in zip(moving.labels, moving.values)
        ]
    found.append(f"orders are {'whole' if case.whole else 'any'} numbers of {case.unit}s")
    total = sum(each.value.size for each in numbers.values())
    return [*found, f"{len(numbers)} inputs with {total} numbers, each with a sensitivity"]


def study(case: NetworkCase, options: Options) -> Study:
    """Training, service by place, rivals, moves, distribution, bands, certificate."""
    without_references(options)
    setup = make_setup(case, options.engine)
    units = units_of(case)
    leads = [LEAD_TIMES] if case.other_leads else []
    parts = [TRAINING, SERVICE, RIVALS, MOVES.part, *leads, DISTRIBUTION.part,
             profile(without=("likelihood",)).part, CERTIFICATE.part]  # fmt: skip
    return Study(
        "inventory",
        _about(case, units),
        tuple(parts),
        result,
        lambda: setup,
        moved=moved_setup,
        inputs=network_inputs,
        shown=service_and_costs,
    )


def units_of(case: NetworkCase) -> dict[str, str]:
    """Units of states, action and outputs."""
    ways = (*AVERAGES, "sent", "received")
    names = [f"{way}_{place.name}" for way in ways for place in case.places]
    amounts = dict.fromkeys((*AVERAGES, *names), f"{case.unit}/{case.period}")
    states = dict.fromkeys(("coming", "action"), case.unit)
    orders = ["orders", *(f"orders_{place.name}" for place in case.places)]
    counts = dict.fromkeys(orders, f"1/{case.period}") | {"short": ""}
    return dict.fromkeys(OUTPUTS, case.value_unit) | amounts | states | counts


def _about(case: NetworkCase, units: dict[str, str]) -> dict[str, Any]:
    sells = [case.places[i] for i in case.sellers]
    demand = "; ".join(f"{each.name}: {each.demand.words()}" for each in sells if each.demand)
    more = {"network": True, "lost": case.lost, "demand": demand, "other_leads": case.other_leads}
    return about(case, units) | more
