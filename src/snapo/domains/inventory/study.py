"""The study of an inventory case: the parts of a run, and the headline of its result."""

from typing import Any

from snapo.problem.problem import Problem
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import profile
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.study import Part, Study, StudyRun
from snapo.study.training import TRAINING

from .item.records import InventoryCase
from .item.simulator import AVERAGES, OUTPUTS, InventorySimulator, inputs_of
from .results.lead_time import LEAD_TIME
from .results.levels import LEVELS, today
from .results.measured import Measured
from .results.rivals import RIVALS
from .results.shown import service_and_costs
from .setup import case_of, make_setup, moved_setup
from .told import about, result, without_references

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

KIND = "inventory"


def lines(case: InventoryCase) -> list[str]:
    """The case in a few lines: nothing is trained."""
    item, numbers = case.item, inputs_of(case)
    unmet = "lost" if item.lost else "delivered later"
    after = f", after {case.warm_up} that do not count" if case.warm_up else ""
    return [
        f"{case.title}: {case.periods} {case.period}s{after}",
        f"demand of a {case.period}: {case.demand.words()}; without stock it is {unmet}",
        f"an order arrives after {item.lead} {case.period}s; "
        f"{'whole' if item.whole else 'any'} numbers of {case.unit}s",
        f"base-stock level to start from: {_level(case):,.4g} {case.unit}s",
        f"{len(numbers)} inputs with {sum(each.value.size for each in numbers.values())} numbers, "
        "each with a sensitivity",
    ]


def _level(case: InventoryCase) -> float:
    from snapo.problem.objective import Mean

    simulator = InventorySimulator(case)  # pyright: ignore[reportCallIssue]
    problem = Problem(simulator, inputs_of(case), Mean("result"))
    return float(problem.schedule.steps["level"][case.warm_up])


def study(case: InventoryCase, options: Options) -> Study:
    """Training, service and costs, the rule as a table, rivals, lead time, moves, certificate."""
    without_references(options)
    setup = make_setup(case, options.engine)
    units = units_of(case)
    parts = [
        TRAINING,
        SERVICE,
        LEVELS,
        RIVALS,
        MOVES.part,
        *([LEAD_TIME] if case.other_leads else []),
        DISTRIBUTION.part,
        profile(without=("likelihood", "missed")).part,
        CERTIFICATE.part,
    ]
    return Study(
        KIND,
        _about(case, units),
        tuple(parts),
        result,
        lambda: setup,
        moved=moved_setup,
        today=today,  # pyright: ignore[reportArgumentType]
        inputs=inputs_of,
        shown=service_and_costs,
    )


def units_of(case: InventoryCase) -> dict[str, str]:
    """Units of states, action and outputs."""
    money = dict.fromkeys(OUTPUTS, case.value_unit)
    amounts = dict.fromkeys(AVERAGES, f"{case.unit}/{case.period}")
    states = dict.fromkeys(("stock", "coming", "action"), case.unit)
    orders = dict.fromkeys(("orders", "cycles", "cycles_met"), f"1/{case.period}")
    return money | amounts | states | {"short": ""} | orders


def _about(case: InventoryCase, units: dict[str, str]) -> dict[str, Any]:
    return about(case, units) | {
        "lead_time": case.item.lead,
        "other_leads": case.other_leads,
        "lost": case.item.lost,
        "demand": case.demand.words(),
    }
