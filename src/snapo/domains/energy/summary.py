"""The text that `snapo check` prints for a contract, computed in NumPy; nothing is compiled."""

from typing import Any

from snapo.case.error import counted
from snapo.case.given import CaseInput
from snapo.problem.record import Schedule
from snapo.problem.record.either import with_numpy
from snapo.study.kind import inputs_line

from ..gas_storage.contract.terms import discount
from .core.feasibility import charged, check_limits, intervals
from .core.schedule import Constants, Step
from .methods.grid import check_nodes
from .methods.intrinsic import intrinsic_value
from .read.case import EnergyCase


def lines(case: EnergyCase) -> list[str]:
    """The case in a few lines; nothing is trained.

    **Raises:** `CaseError` if its limits cannot be met, see `check_limits`.
    """
    layout, schedule = case.contract.layout, known_schedule(case)
    check_limits(case, schedule)
    check_nodes(case, schedule)
    return [
        f"{case.title}: {counted(len(case.days), 'decision')}, {case.days[0]} to {case.days[-1]}",
        f"levels: {', '.join(x.name for x in layout.levels) or 'none'}; "
        f"flows: {', '.join(x.name for x in layout.flows)}",
        inputs_line([entry.value.size for entry in case.inputs().values()]),
        f"intrinsic value {intrinsic_value(layout, schedule):,.2f} {case.currency}",
        "the contract can be met",
    ]


@with_numpy
def known_schedule(case: EnergyCase) -> Schedule:
    """The schedule of a case at its forward prices, in NumPy, without the numbers of the price
    process.

    It equals the result of `EnergySimulator.prepare` for the inputs of the case, up to rounding.
    """
    market, at = case.market, CaseInput.used
    paid, settled = (discount(market, days) for days in (market.gas_day, case.day + 1))
    start, terms = case.contract.terms(at, paid, settled)  # pyright: ignore
    forward: Any = at(market.forward_curve)[: len(case.days)]
    terms = charged(terms, forward)
    ranges = intervals(case.contract.layout, terms)
    none: Any = None  # only paths and policies read it
    steps = Step(case.time, forward, terms, ranges, case.model.second_price(), none)  # pyright: ignore
    return Schedule(Constants(start, none, none, none, none), steps)
