"""The text that `snapo check` prints for a contract, by NumPy; nothing is compiled."""

from snapo.lanes.program.in_numpy import in_numpy
from snapo.problem.inputs import plain
from snapo.study.kind import inputs_line

from .core.feasibility import check_limits
from .core.intraday import simulator_kind
from .methods.grid import check_nodes
from .methods.intrinsic import intrinsic_value
from .read.case import EnergyCase


def lines(case: EnergyCase) -> list[str]:
    """The case in a few lines: nothing is trained.

    **Raises:** `CaseError` where it cannot be met, see `check_limits`.
    """
    inputs, layout = case.inputs(), case.contract.layout
    schedule = in_numpy(simulator_kind(case).bare(case).prepare)(plain(inputs))
    check_limits(case, schedule)
    check_nodes(case, schedule)
    return [
        f"{case.title}: {len(case.days)} decisions, {case.days[0]} to {case.days[-1]}",
        f"levels: {', '.join(x.name for x in layout.levels) or 'none'}; "
        f"flows: {', '.join(x.name for x in layout.flows)}",
        inputs_line([entry.value.size for entry in inputs.values()]),
        f"intrinsic value {intrinsic_value(layout, schedule):,.2f} {case.currency}",
        "the contract can be met",
    ]
