"""The text that `snapo check` prints for an item or a network; nothing is compiled."""

from statistics import NormalDist

import numpy as np

from snapo.case.error import counted, plural
from snapo.problem.record.either import with_numpy
from snapo.study.kind import inputs_line

from .demand.base import MEAN
from .item.estimates import base_stock, safety_factor, season_ahead
from .item.records import InventoryCase
from .network.records import NetworkCase


def lines(case: InventoryCase | NetworkCase) -> list[str]:
    """The case in a few lines; nothing is trained."""
    describe = _network_lines if isinstance(case, NetworkCase) else _item_lines
    last = inputs_line([entry.value.size for entry in case.inputs().values()])
    return [*describe(case), last]  # pyright: ignore[reportArgumentType]


def _item_lines(case: InventoryCase) -> list[str]:
    item = case.item
    unmet = "lost" if item.lost else "delivered later"
    integers = "whole" if item.integer else "any"
    parameters, factors = case.demand.values(), case.season.values if case.seasonal else np.ones(1)
    season = season_ahead(factors, case.horizon, item.lead_time)
    mean, deviation = parameters[MEAN] * season, case.demand.deviation(parameters, season)
    safety = safety_factor(case, NormalDist().inv_cdf)
    level = float(with_numpy(base_stock)(mean, deviation, safety)[case.warm_up])
    return [
        f"{case.title}: {_periods(case)}",
        f"demand of a {case.period}: {case.demand.describe()}; demand that exceeds the stock "
        f"{unmet}",
        f"an order arrives after {counted(item.lead_time, case.period)}; orders are {integers} "
        f"numbers of "
        f"{plural(case.unit)}",
        f"initial base-stock level: {counted(level, case.unit)}",
    ]


def _network_lines(case: NetworkCase) -> list[str]:
    sites = case.network.sites
    rows = [f"{case.title}: {len(sites)} places, {_periods(case)}"]
    customers = dict(zip(case.network.sellers, zip(case.demands, case.seasons)))
    for i, site in enumerate(sites):
        supplier = "outside" if site.supplier is None else sites[site.supplier].name
        row = f"{site.name}: from {supplier} in {counted(site.lead_time, case.period)}"
        if i in customers:
            demand, season = customers[i]
            row += f"; demand {demand.describe()}"
            row += f", a season of {counted(len(season.values), case.period)}" if season else ""
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
        f"orders are {'whole' if case.network.integer else 'any'} numbers of {plural(case.unit)}",
    ]


def _periods(case: InventoryCase | NetworkCase) -> str:
    after = f", after {case.warm_up} for the warm-up, which do not count" if case.warm_up else ""
    return f"{counted(case.periods, case.period)}{after}"
