"""Reads an inventory case: a TOML file and the CSVs next to it become an `InventoryCase`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.plausible import CaseFiles
from snapo.case.table import TableContext, parse

from ..demand.registry import read_demand
from ..item.records import InventoryCase, Item
from .settings import no_season, read_season, read_settings, unit_slips
from .tables import HorizonTable, InventoryTable, ItemReportTable, ItemTable


def read_case(file: Path, data: Mapping[str, Any]) -> InventoryCase:
    """The case in the TOML file `file`, whose tables `data` have already been read.

    **Raises:** `CaseError` if a table, a file or a number is wrong.
    """
    name, notes = str(file), []
    top = parse(InventoryTable, data, name, "")
    table = parse(ItemTable, top.item, name, "item")
    horizon = parse(HorizonTable, top.horizon, name, "horizon")
    season = (
        read_season(TableContext(file, "season", notes), top.season) if top.season else no_season()
    )
    per = f"{table.unit}/{table.period}"
    maximum = float(season.values.max())
    demand = read_demand(TableContext(file, "demand", notes), top.demand, per, maximum)
    item = _item(
        TableContext(file, "item", notes),
        table,
        demand.integer or (demand.in_pieces() and len(season.values) == 1),
    )
    inputs = [*item.inputs(), *demand.inputs(), season]
    notes += unit_slips(CaseFiles(file, data), [*inputs, horizon.discount], table.period)
    return InventoryCase(
        **read_settings(top, name),
        file=file,
        notes=tuple(notes),
        title=top.title,
        currency=table.currency,
        unit=table.unit,
        period=table.period,
        item=item,
        periods=horizon.periods,
        warm_up=_warm_up(horizon, item),
        discount=horizon.factor,
        demand=demand,
        season=season,
        other_leads=parse(ItemReportTable, top.report, name, "report").lead_time,
    )


def _item(section: TableContext, table: ItemTable, complete: bool) -> Item:
    if table.whole and not complete:
        section.notes.append("Orders are in whole units, but demand is not.")
    shortage = table.shortage
    if table.unmet == "lost":
        by_unit, text = f"{table.currency}/{table.unit}", "cost of a unit of demand that is lost"
        shortage = replace(shortage, unit=by_unit, meaning=text)
    return Item(
        lost=table.unmet == "lost",
        lead_time=table.lead_time,
        integer=complete if table.whole is None else table.whole,
        maximum=float("inf") if table.most is None else float(table.most),
        holding=table.holding,
        shortage=shortage,
        purchase=table.purchase,
        ordering=table.order,
        stock=None
        if table.stock is None
        else replace(table.stock, labels=("now",), index=np.arange(1)),
        coming=table.coming,
    )


def _warm_up(table: HorizonTable, item: Item) -> int:
    """The number in the case. Its default is ten times (lead time + 1) for an average, and 0 if
    money is discounted."""
    if table.warm_up is not None:
        return table.warm_up
    return 0 if table.factor < 1 else 10 * (item.lead_time + 1)
