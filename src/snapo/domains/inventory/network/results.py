"""Service and costs of a network and its places."""

from typing import Any

from snapo.study.study import Part, StudyRun

from ..results.measured import Measured
from .setup import network_of


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
