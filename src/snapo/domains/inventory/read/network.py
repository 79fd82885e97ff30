"""Reads a case with places: the tables `[network]`, `[[place]]` and `[[transshipment]]`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.plausible import CaseFiles, checked_numbers
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import (
    EvaluationKey,
    EvaluationTable,
    ObjectiveKey,
    ObjectiveTable,
    TrainingKey,
    TrainingTable,
)
from snapo.case.table import CaseTable, TableContext, Title, doc, parse, subtable

from ..demand.base import Demand
from ..demand.registry import kinds, read_demand
from ..network.records import NetworkCase, Pool, Site, SupplyNetwork
from .settings import read_season, read_settings, unit_slips
from .tables import (
    COST,
    HOLDING,
    OTHER_LEADS,
    HorizonKey,
    HorizonTable,
    InventoryTable,
    ItemReportTable,
    ItemTable,
    LeadTime,
    MoneyName,
    PeriodName,
    SeasonTable,
    UnitName,
    WholeOrders,
)

MAXIMUM = 12  # places
PlaceName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]
PlaceNames = Annotated[list[PlaceName], Field(min_length=2, max_length=MAXIMUM)]
PLACE = "a name of letters, digits, - and _ that starts with a letter, at most 40 characters"


class NetworkTable(CaseTable):
    """`[network]`"""

    unmet: Literal["lost", "waits"] = doc("whether unmet demand is lost or waits", "waits")
    whole: WholeOrders
    currency: MoneyName
    unit: UnitName
    period: PeriodName


class PlaceTable(CaseTable):
    """One `[[place]]`."""

    name: PlaceName = doc("name of the place", allowed=PLACE)
    supplier: PlaceName | None = doc(
        "place that supplies this place; by default an outside source with unlimited supply",
        None,
        "the name of another place",
    )
    lead_time: LeadTime
    holding: CaseInput = HOLDING(
        "cost per period of a unit at the place, or on its way to a place that it supplies",
        name="holding_cost",
    )
    shortage: CaseInput | None = HOLDING(
        "cost of a unit of unmet demand", None, name="shortage_cost"
    )
    order: CaseInput = COST("cost of an order of any size", 0.0, name="order_cost")
    demand: dict[str, Any] | None = doc(
        "distribution of the demand of the place's customers", None, "a table, as [demand]"
    )
    season: dict[str, Any] | None = doc(
        "season of the place's demand", None, "a table, as [season]"
    )


class NetworkReportTable(ReportTable):
    """`[report]` of a case with places."""

    lead_time: bool = doc(OTHER_LEADS, False)


class TransshipmentTable(CaseTable):
    """One `[[transshipment]]`."""

    between: PlaceNames = doc(
        "places that send units to one another",
        allowed="a list of the names of 2 or more places with customers",
    )
    cost: CaseInput = COST("cost of a unit that one store sends another", name="transshipment_cost")
    when: Literal["after", "before"] = doc(
        "whether units are sent after or before demand is known",
        "after",
        '"after" or "before" (demand)',
    )
    one_way: bool = doc("whether only the first of the two places sends units", False)


class NetworkFile(CaseTable):
    """The whole file."""

    kind: Literal["inventory"] = doc("kind of the case")
    title: Title = "Network"
    network: dict = subtable("units and rules of the network", "network", {})
    place: list[Any] = doc("places of the network", allowed="a list of tables, [[place]]")
    transshipment: list[Any] = doc(
        "places that send units to one another", [], "a list of tables, [[transshipment]]"
    )
    horizon: HorizonKey
    report: ReportKey
    objective: ObjectiveKey
    training: TrainingKey
    evaluation: EvaluationKey


FORMATS = {
    "": [InventoryTable, NetworkFile],
    "item": ItemTable,
    "season": SeasonTable,
    "network": NetworkTable,
    "demand": [demand.table for demand in kinds().values()],
    "place[]": PlaceTable,
    "place[].demand": [demand.table for demand in kinds().values()],
    "place[].season": SeasonTable,
    "transshipment[]": TransshipmentTable,
    "horizon": HorizonTable,
    "report": [ItemReportTable, NetworkReportTable],
    "objective": ObjectiveTable,
    "training": TrainingTable,
    "evaluation": EvaluationTable,
}


def read_network(file: Path, data: Mapping[str, Any]) -> NetworkCase:
    """The case whose tables are `data`.

    **Raises:** `CaseError` for every mistake."""
    name, notes = str(file), []
    top = parse(NetworkFile, data, name, "")
    table = parse(NetworkTable, top.network, name, "network")
    horizon = parse(HorizonTable, top.horizon, name, "horizon")
    rows = [parse(PlaceTable, item, name, f"place[{i}]") for i, item in enumerate(top.place)]
    sections = [TableContext(file, f"place[{i}]", notes) for i in range(len(rows))]
    _check(rows, sections, TableContext(file, "network", notes), table.unmet)
    names = [row.name for row in rows]
    per = f"{table.unit}/{table.period}"
    places = [_place(row, section, names, per) for row, section in zip(rows, sections)]
    money = f"{table.currency}/{table.unit}"
    by_period = f"{money}/{table.period}"
    held = _by_label({row.name: row.holding for row in rows}, by_period)
    shortages = {row.name: row.shortage for row in rows if row.shortage is not None}
    short = _by_label(shortages, money if table.unmet == "lost" else by_period)
    pools, moving = _pools(file, notes, top.transshipment, rows, money)
    paying = {row.name: row.order for row in rows if _pays(row)}
    ordering = _by_label(paying, table.currency) if paying else None
    total = sum(row.lead_time + 1 for row in rows)
    usual = 0 if horizon.factor < 1 else 10 * total
    demands = [demand for _, demand, _ in places if demand is not None]
    seasons = [season for site, _, season in places if site.sells]
    complete = all(map(_whole, demands, seasons))
    case = NetworkCase(
        **read_settings(top, name),
        file=file,
        notes=(),
        title=top.title,
        currency=table.currency,
        unit=table.unit,
        period=table.period,
        network=SupplyNetwork(
            tuple(site for site, _, _ in places),
            pools,
            table.unmet == "lost",
            complete if table.whole is None else table.whole,
            () if moving is None else tuple(np.argsort(moving.values, kind="stable").tolist()),
        ),
        demands=tuple(demands),
        seasons=tuple(seasons),
        holding=held,
        shortage=short,
        transshipment=moving,
        ordering=ordering,
        periods=horizon.periods,
        warm_up=usual if horizon.warm_up is None else horizon.warm_up,
        discount=horizon.factor,
        other_leads=parse(NetworkReportTable, top.report, name, "report").lead_time,
    )
    inputs = [cost for cost in (held, short, moving) if cost is not None]
    of_demand = [checked_numbers(x)._replace(name=key) for key, x in case.of_demand.items()]
    slips = unit_slips(CaseFiles(file, data), [*inputs, *of_demand, horizon.discount], table.period)
    return replace(case, notes=(*notes, *slips))


def _check(
    rows: list[PlaceTable], sections: list[TableContext], complete: TableContext, unmet: str
) -> None:
    """Checks names, that suppliers form no circle, that all goods can reach customers, and that
    places with customers have a shortage cost."""
    names = [row.name for row in rows]
    if not 1 <= len(rows) <= MAXIMUM:
        raise complete.error("place", len(rows), f"there must be 1 to {MAXIMUM} tables [[place]]")
    for i, (row, section) in enumerate(zip(rows, sections)):
        if row.name in names[:i]:
            raise section.error("name", row.name, "another place has this name")
        if row.supplier is not None and row.supplier not in names:
            raise section.error("supplier", row.supplier, f"the places are {', '.join(names)}")
        if (row.demand is None) != (row.shortage is None):
            key = "shortage" if row.shortage is None else "demand"
            message = (
                "a place with customers needs both demand and shortage; any other place "
                "must have neither"
            )
            raise section.error(key, None, message)
        supplying = any(item.supplier == row.name for item in rows)
        if row.demand is None and not supplying:
            raise section.error(
                "demand", None, "this place has no customers and supplies no other place"
            )
        if row.demand is not None and supplying:
            message = (
                "a place that supplies another place must not have customers; add a place "
                "for the customers"
            )
            raise section.error("demand", row.demand, message)
        observed, here = {row.name}, row.supplier
        while here is not None:
            if here in observed:
                raise section.error(
                    "supplier",
                    row.supplier,
                    "the suppliers form a circle: at least one place must order from outside",
                )
            observed.add(here)
            here = rows[names.index(here)].supplier


def _pools(
    file: Path, notes: list[str], tables: list[Any], rows: list[PlaceTable], money: str
) -> tuple[tuple[Pool, ...], CaseInput | None]:
    """The pools of stores, and the cost of a unit moved in each; None if there are none."""
    names, sell = [row.name for row in rows], [row.name for row in rows if row.demand is not None]
    pools, costs = [], {}
    for i, item in enumerate(tables):
        section = TableContext(file, f"transshipment[{i}]", notes)
        table = parse(TransshipmentTable, item, str(file), section.name)
        if unknown := [name for name in table.between if name not in sell]:
            message = f"the places with customers are {', '.join(sell)}"
            raise section.error("between", unknown[0], message)
        if len(set(table.between)) < len(table.between):
            raise section.error("between", table.between, "a place may be listed only once")
        if table.one_way and len(table.between) != 2:
            message = (
                "with one_way there must be two places, the first of which sends to the second"
            )
            raise section.error("one_way", True, message)
        sites = tuple(names.index(name) for name in table.between)
        pool = Pool(sites if table.one_way else tuple(sorted(sites)), table.one_way,
                    table.when == "before")  # fmt: skip
        if pool in pools:
            raise section.error("between", table.between, "another table has the same places")
        pools.append(pool)
        ways = " to " if table.one_way else ", "
        early = " (before demand)" if pool.before else ""
        costs[ways.join(table.between) + early] = table.cost
    return tuple(pools), _by_label(costs, money) if pools else None


def _place(
    row: PlaceTable, section: TableContext, names: list[str], unit: str
) -> tuple[Site, Demand | None, CaseInput | None]:
    """The place of one table, with its demand and season; `unit`: the unit of demand in a
    period."""
    supplier = names.index(row.supplier) if row.supplier is not None else None
    demand, season = None, None
    if row.season is not None:
        if row.demand is None:
            message = "only a place with customers can have a season"
            raise section.error("season", row.season, message)
        season = read_season(_inner(section, "season"), row.season)
    if row.demand is not None:
        maximum = float(season.values.max()) if season is not None else 1.0
        demand = read_demand(_inner(section, "demand"), row.demand, unit, maximum)
    sells, seasonal = demand is not None, season is not None
    site = Site(row.name, supplier, row.lead_time, sells, seasonal, _pays(row))
    return site, demand, season


def _inner(section: TableContext, name: str) -> TableContext:
    return TableContext(section.file, f"{section.name}.{name}", section.notes)


def _whole(demand: Demand, season: CaseInput | None) -> bool:
    """Whether all demand is in whole units; a history that a season multiplies is not."""
    return demand.integer or (demand.in_pieces() and season is None)


def _pays(row: PlaceTable) -> bool:
    """Whether an order has a cost that does not depend on its size."""
    return bool(row.order.values[0] > 0)


def _by_label(costs: Mapping[str, CaseInput], unit: str) -> CaseInput:
    """The costs of one kind in several tables, as one input in `unit`."""
    parts = list(costs.values())
    values = [part.values[0] for part in parts]
    locations = tuple(part.positions[0] for part in parts)
    quantity = replace(parts[0].quantity, unit=unit)
    return quantity.input(parts[0].name, values, list(costs), positions=locations)
