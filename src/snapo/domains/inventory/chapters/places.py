"""Stock, demand and fill rate of every place of a network, and transfers between stores."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from snapo.report.folder import RunFiles
from snapo.report.page import Block, Text
from snapo.report.quantity import decimals, percent
from snapo.report.rows import Column, WithError, table
from snapo.study.chapter import Chapter
from snapo.study.study import LiveTable, PathTotals, StudyRun

from ..network.records import NetworkCase, Site
from ..setup import network_of
from . import service
from .about import CaseSummary
from .service import CostAndService, PathMean


@dataclass(frozen=True)
class PlaceService:
    """A place: averages per period, each with its standard error.

    - `level`: the order-up-to level; if an order has a cost, the mean over orders only.
    - `supplier`: empty if goods come from outside.
    - `orders`, `order_size`: the number of orders in a period and their size, if an order has a
      cost; `sent`, `received`: transfers in a period, only for places in a pool.
    - `demand`, `fill_rate`: only for places with customers.
    """

    name: str
    level: PathMean
    supplier: str
    stock: PathMean
    orders: PathMean | None = None
    order_size: PathMean | None = None
    demand: PathMean | None = None
    fill_rate: PathMean | None = None
    sent: PathMean | None = None
    received: PathMean | None = None


@dataclass(frozen=True)
class NetworkService(CostAndService):
    """Service and costs of the whole network and of every place."""

    places: tuple[PlaceService, ...]


def measure(run: StudyRun) -> NetworkService:
    """Measures service and costs as for an item, and all places."""
    case, paths = network_of(run.setup), service.paths_of(run)
    optional = [(case.ordering, "ordering"), (case.transshipment, "transshipment")]
    names = ["holding", "shortage", *(name for cost, name in optional if cost is not None)]
    sites = tuple(_place(case, site, paths) for site in case.network.sites)
    return NetworkService(service.service_of(paths), service.costs_of(paths, names), sites)


def _place(case: NetworkCase, site: Site, paths: PathTotals) -> PlaceService:
    name, fixed, sells = site.name, site.fixed, site.sells
    pooled, level, orders = f"sent_{name}" in paths.totals, f"level_{name}", f"orders_{name}"
    return PlaceService(
        name,
        service.ratio(paths, level, orders) if fixed else service.total(paths, level),
        "" if site.supplier is None else case.network.sites[site.supplier].name,
        service.total(paths, f"stock_{name}"),
        service.total(paths, orders) if fixed else None,
        service.ratio(paths, f"ordered_{name}", orders) if fixed else None,
        service.total(paths, f"demand_{name}") if sells else None,
        service.ratio(paths, f"sold_{name}", f"demand_{name}") if sells else None,
        service.total(paths, f"sent_{name}") if pooled else None,
        service.total(paths, f"received_{name}") if pooled else None,
    )


def show(run: RunFiles, result: NetworkService) -> Sequence[Block]:
    """A table with a row for every place."""
    case, sites = CaseSummary.of(run), result.places
    unit, digits = (
        case.item_unit,
        decimals([site.stock.value for site in sites], 4),
    )

    def mean(name: str, label: str, unit: str, digits: int) -> Column:
        return Column(label, lambda site: _value(getattr(site, name)), unit, decimal_places=digits)

    columns = [
        Column("Place", "name"),
        Column("Supplied by", lambda site: site.supplier or "outside"),
        mean("level", "Order-up-to level", unit, 2),
        Column("Stock", lambda site: WithError(site.stock.value, site.stock.standard_error),
               unit, decimal_places=digits),
        mean("demand", "Demand", unit, digits),
        Column("Fill rate", lambda site: percent(_value(site.fill_rate), 2)),
    ]  # fmt: skip
    text = (
        "Stock is the average on hand at the end of a period. The level up to which a place "
        "orders is the mean over periods of the following sum: all goods at the place, on their "
        "way to it and further downstream, minus demand that waits, plus the order."
    )
    if any(place.sent for place in sites):
        columns += [mean("sent", "Sent", unit, digits), mean("received", "Received", unit, digits)]
        text += " Sent and received are the transfers between stores in a period."
    if any(place.orders for place in sites):
        columns.append(mean("orders", "Orders", f"1/{case.step}", 2))
        columns.append(mean("order_size", "Order size", unit, 2))
        text += (
            " If an order has a fixed cost, the level is the mean over the periods with an order."
        )
    rows = table(sites, columns, "Stock and service by place")
    return [rows, Text(text, caveat=True)]


def _value(mean: PathMean | None) -> float | None:
    return None if mean is None else mean.value


PLACES = Chapter("service", "Places", NetworkService, measure, show, short="Places")


def service_and_places(run: StudyRun) -> dict[str, Any]:
    """The part "service" of a network's results; the row of a place omits numbers that it does not
    have."""
    entries = PLACES.data(measure(run))
    rows = [{name: x for name, x in row.items() if x is not None} for row in entries["places"]]
    return entries | {"places": rows}


def network_tables(paths: PathTotals) -> list[LiveTable]:
    """Tables of service, costs and places for the live page."""
    case = network_of(paths.setup)
    columns = (("place", ""), ("stock", case.unit), ("±", ""), ("fill rate", "%"), ("±", ""))
    rows = []
    for site in (_place(case, location, paths) for location in case.network.sites):
        rate = site.fill_rate.times(100) if site.fill_rate else (None, None)
        rows.append((site.name, *site.stock.times(1), *rate))
    return [*service.live_tables(paths), LiveTable("Places", columns, rows)]
