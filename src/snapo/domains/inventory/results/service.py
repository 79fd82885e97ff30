"""Service, stock and costs of the trained rule, on the paths of the value."""

from typing import Any

from snapo.study.study import Part, StudyRun

from ..setup import case_of
from .measured import Measured

COSTS = ("holding", "shortage", "purchase", "ordering")


def work(run: StudyRun) -> dict[str, Any]:
    """ "service": {name: {"value", "standard_error"}} of fill rate (demand met from stock at once),
    cycle service (replenishment cycles without unmet demand), periods without unmet demand, stock
    at the end of a period, orders a period, units of an order, demand a period; "costs": one row
    per part of the cost."""
    case, found = case_of(run.setup), Measured.of(run)
    more = {"orders": found.total("orders"), "order_size": found.ratio("ordered", "orders")}
    kept = [name for name in COSTS if case.item.cost(name) > 0]
    costs = [{"name": name, **found.total(name)} for name in kept]
    return {"service": found.service() | more, "costs": costs}


SERVICE = Part("service", work, needs=("training",))
