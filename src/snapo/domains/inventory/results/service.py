"""Service, stock and costs of the trained rule, on the paths of the value."""

from typing import Any

import numpy as np

from snapo.solver import statistics
from snapo.study.study import Part, StudyRun

from ..setup import case_of

COSTS = ("holding", "shortage", "purchase", "ordering")


def work(run: StudyRun) -> dict[str, Any]:
    """ "service": {name: {"value", "standard_error"}} of fill rate (demand met from stock at once),
    cycle service (periods without unmet demand), stock at the end of a period, orders a period,
    units of an order, demand a period; "costs": one row per part of the cost."""
    case, totals = case_of(run.setup), run.solution.totals
    source = run.setup.problem.sources.evaluation
    groups = source.groups(np.arange(run.solution.paths["evaluate"]))

    def mean(values) -> dict[str, float]:
        return _said(statistics.mean(np.asarray(values, np.float64), groups))

    def ratio(top: str, bottom: str) -> dict[str, float]:
        return _said(statistics.ratio(totals[top], totals[bottom], groups))

    service = {
        "fill_rate": ratio("sold", "demand"),
        "cycle_service": mean(1 - np.asarray(totals["short"], np.float64)),
        "stock": mean(totals["stock"]),
        "orders": mean(totals["orders"]),
        "order_size": ratio("ordered", "orders"),
        "demand": mean(totals["demand"]),
    }
    kept = [name for name in COSTS if case.item.cost(name) > 0]
    costs = [{"name": name, **mean(totals[name])} for name in kept]
    return {"service": service, "costs": costs}


SERVICE = Part("service", work, needs=("training",))


def _said(found: statistics.Sampled) -> dict[str, float]:
    return {"value": found.value, "standard_error": found.standard_error}
