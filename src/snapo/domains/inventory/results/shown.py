"""Service and costs of the trained rule, as the live page shows them."""

from collections.abc import Sequence

from snapo.study import study
from snapo.study.study import Shown

from ..item.records import InventoryCase
from ..network.records import NetworkCase
from .measured import Measured

COLUMNS = (("", ""), ("mean", ""), ("± standard error", ""))
COSTS = ("holding", "shortage", "purchase", "ordering", "transshipment")


def service_and_costs(found: study.Measured) -> Sequence[Shown]:
    """Fill rate, service, stock and demand; and what a period costs by part."""
    case = found.setup.problem.simulator.case  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(case, InventoryCase | NetworkCase)
    told = Measured(found.totals, found.groups)
    units = {"stock": case.unit, "demand": f"{case.unit}/{case.period}"}
    rows = []
    for name, each in told.service().items():
        share = name not in units
        factor = 100 if share else 1
        row = (factor * each["value"], factor * each["standard_error"])
        rows.append((f"{name.replace('_', ' ')}, {'%' if share else units[name]}", *row))
    costs = []
    for name in COSTS:
        if name in found.totals and (each := told.total(name))["value"]:
            costs.append((f"{name}, {case.value_unit}", each["value"], each["standard_error"]))
    shown = [Shown("Service", COLUMNS, rows), Shown("Costs by part", COLUMNS, costs)]
    if isinstance(case, NetworkCase):
        columns = (("place", ""), ("stock", case.unit), ("±", ""), ("fill rate", "%"), ("±", ""))
        shown.append(Shown("Places", columns, _places(case, told)))
    return shown


def _places(case: NetworkCase, told: Measured) -> list[tuple]:
    rows = []
    for place in case.places:
        stock = told.total(f"stock_{place.name}")
        row = (place.name, stock["value"], stock["standard_error"])
        rate = (None, None)
        if place.demand is not None:
            sold = told.ratio(f"sold_{place.name}", f"demand_{place.name}")
            rate = (100 * sold["value"], 100 * sold["standard_error"])
        rows.append((*row, *rate))
    return rows
