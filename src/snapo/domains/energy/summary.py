"""What `snapo check` prints of a contract, in NumPy: nothing is compiled."""

from typing import Any

from snapo.case.error import CaseError
from snapo.problem.in_numpy import in_numpy
from snapo.problem.inputs import plain

from .core.feasibility import first_fault
from .core.intraday import simulator_kind
from .methods.lattice import lattice
from .read.case import EnergyCase


def lines(case: EnergyCase) -> list[str]:
    """The case in a few lines: nothing is trained.

    **Raises:** `CaseError` where it cannot be met, see `check_limits`.
    """
    inputs, layout = case.inputs(), case.contract.layout
    schedule = in_numpy(simulator_kind(case).bare(case).prepare)(plain(inputs))
    check_limits(case, schedule)
    numbers = sum(entry.value.size for entry in inputs.values())
    return [
        f"{case.title}: {len(case.days)} decisions, {case.days[0]} to {case.days[-1]}",
        f"levels: {', '.join(x.name for x in layout.levels) or 'none'}; "
        f"flows: {', '.join(x.name for x in layout.flows)}",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity",
        f"intrinsic value {lattice(layout, schedule, None).value:,.2f} {case.currency}",
        "the contract can be met",
    ]


def check_limits(case: EnergyCase, schedule: Any) -> None:
    """Refuses a contract that cannot be met; `schedule`: with NumPy leaves.

    **Raises:** `CaseError` with the first step and level that no decisions can keep.
    """
    layout = case.contract.layout
    fault = first_fault(layout, schedule)
    if fault is not None:
        step, level = fault
        day = case.days[max(step, 0)]
        name = layout.levels[level].name
        raise CaseError(str(case.file), f"contract: {name}", None,
                        f"its limits cannot be met from {day} on, whatever is decided")  # fmt: skip
