"""The cost, its parts, and the service that results, for a planner."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from snapo.report.evidence import notes
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Headline, Section, Table
from snapo.report.quantity import (
    PLUS_MINUS,
    decimals,
    measured,
    number,
    percent,
    plus_minus,
    quantity,
)
from snapo.study.chapter import Chapter, Number
from snapo.study.chapters.bound import optimum
from snapo.study.chapters.headline import marks
from snapo.study.study import LiveTable, PathTotals, StudyRun

from ..setup import AnyCase, case_of
from .about import CaseSummary

COSTS = ("holding", "shortage", "purchase", "ordering", "transshipment")
SHARES = {
    "fill_rate": ("Fill rate", "of demand is met from stock immediately"),
    "cycle_service": ("Cycle service", "of replenishment cycles have no unmet demand"),
    "period_service": ("Periods without shortage", "of all periods"),
}
AMOUNTS = {
    "stock": ("Average stock", "at the end of a period"),
    "orders": ("Orders", "in a period"),
    "order_size": ("Order size", "mean"),
    "demand": ("Demand", "mean per period"),
}


@dataclass(frozen=True)
class PathMean:
    """A mean over the paths of the value, and its standard error."""

    value: Number
    standard_error: Number

    def times(self, factor: float) -> tuple[float, float]:
        """The mean and its error in another unit."""
        return factor * self.value, factor * self.standard_error


@dataclass(frozen=True)
class CostPart:
    """A part of the cost: its mean over the paths, and the standard error."""

    name: str
    value: Number
    standard_error: Number


@dataclass(frozen=True)
class CostAndService:
    """Service and costs.

    - `service`: {name: mean} with the names of `SHARES` and `AMOUNTS`: the fill rate (share of
      demand met from stock immediately), the share of periods without unmet demand, stock at the
      end of a period, and demand of a period. An item also has the cycle service (share of
      replenishment cycles without unmet demand), the number of orders in a period, and the units of
      an order.
    - `costs`: in the order of `COSTS`.
    """

    service: dict[str, PathMean]
    costs: tuple[CostPart, ...]


def measure(run: StudyRun) -> CostAndService:
    """Measures service and costs of an item."""
    item, paths = case_of(run.setup).item, paths_of(run)
    orders = {"orders": total(paths, "orders"), "order_size": ratio(paths, "ordered", "orders")}
    names = [name for name in COSTS[:4] if item.cost(name) > 0]
    return CostAndService(service_of(paths) | orders, costs_of(paths, names))


def paths_of(run: StudyRun) -> PathTotals:
    """The outputs of the trained rule on the paths of its value."""
    source = run.setup.problem.sources.evaluation
    groups = source.groups(np.arange(run.solution.paths["evaluate"]))
    return PathTotals(run.setup, run.solution.totals, groups)


def total(paths: PathTotals, name: str) -> PathMean:
    """The mean of an output."""
    return PathMean(*paths.mean(paths.totals[name]))


def ratio(paths: PathTotals, top: str, bottom: str) -> PathMean:
    """The ratio of the means of two outputs."""
    return PathMean(*paths.ratio(top, bottom))


def service_of(paths: PathTotals) -> dict[str, PathMean]:
    """The common part of items and networks, and the cycle service of an item."""
    cycles = {}
    if "cycles" in paths.totals:
        cycles["cycle_service"] = ratio(paths, "cycles_met", "cycles")
    return {
        "fill_rate": ratio(paths, "sold", "demand"),
        **cycles,
        "period_service": PathMean(*paths.mean(1 - np.asarray(paths.totals["short"], np.float64))),
        "stock": total(paths, "stock"),
        "demand": total(paths, "demand"),
    }


def costs_of(paths: PathTotals, names: Sequence[str]) -> tuple[CostPart, ...]:
    """The parts of the cost with these names."""
    return tuple(CostPart(name, *paths.mean(paths.totals[name])) for name in names)


def headline(run: RunFiles) -> Section:
    """The section with the cost of the trained rule, and its service."""
    title, value = "Cost and service", run.result.value
    if value is None:
        return Section("value", title, "Cost", [why_missing(run, "training")])
    error = run.result.standard_error
    digits = decimals([value], 6) if not error else max(0, decimals([error], 2))
    if run.unit:
        label, text = "Cost", quantity(-value, run.unit, digits)
    else:
        label, text = "Value", number(value, digits)
    objective = CaseSummary.of(run).objective
    note = f"{objective}; on fresh paths of the exact simulator; {PLUS_MINUS}"
    top = Headline(label, text, plus_minus(error, digits), note, marks=marks(run),
                   context=optimum(run, bool(run.unit)))  # fmt: skip
    blocks: list[Block] = [top, *notes(run), *SERVICE(run).blocks]
    return Section("value", title, "Cost", blocks)


def show(run: RunFiles, result: CostAndService) -> list[Block]:
    """The service as key figures, and the table of costs."""
    case, service = CaseSummary.of(run), result.service
    facts = []
    for name, (label, meaning) in SHARES.items():
        if (mean := service.get(name)) is not None:
            error = plus_minus(100 * mean.standard_error, 2)
            note = f"{meaning} ({error})" if error else meaning
            facts.append((label, percent(mean.value, 2), note))
    for name, (label, meaning) in AMOUNTS.items():
        if (mean := service.get(name)) is not None:
            unit = "" if name == "orders" else case.item_unit
            digits = max(0, decimals([mean.value], 4))
            facts.append((label, quantity(mean.value, unit, digits), meaning))
    return [Facts(facts), _cost_table(result.costs, case.units.get("holding", ""))]


def _cost_table(costs: Sequence[CostPart], unit: str) -> Table:
    everything = sum(cost.value for cost in costs) or 1.0
    digits = decimals([everything], 5)
    rows = [
        (
            cost.name.capitalize(),
            *measured(cost.value, cost.standard_error, digits),
            percent(cost.value / everything),
        )
        for cost in costs
    ]
    rows.append(("All costs", number(everything, digits), "", percent(1.0)))
    head = [("Cost", ""), ("", unit), ("", ""), ("Share", "")]
    return Table(head, rows, "Cost by part", 1, strong=frozenset([len(rows) - 1]))


SERVICE = Chapter("service", "Cost and service", CostAndService, measure, show)


def live_tables(paths: PathTotals) -> list[LiveTable]:
    """Tables of service and costs for the live page."""
    case: AnyCase = paths.setup.case
    units = {"stock": case.unit, "demand": f"{case.unit}/{case.period}"}
    rows = []
    for name, mean in service_of(paths).items():
        unit, factor = (units[name], 1) if name in units else ("%", 100)
        rows.append((f"{name.replace('_', ' ')}, {unit}", *mean.times(factor)))
    costs = costs_of(paths, [name for name in COSTS if name in paths.totals])
    unit = case.value_unit
    parts = [(f"{x.name}, {unit}", x.value, x.standard_error) for x in costs if x.value]
    columns = (("", ""), ("mean", ""), ("±", ""))
    return [LiveTable("Service", columns, rows), LiveTable("Costs by part", columns, parts)]
