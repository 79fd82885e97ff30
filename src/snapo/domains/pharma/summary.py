"""The text that `snapo check` prints for a process; nothing is computed."""

from snapo.case.error import counted
from snapo.study.kind import inputs_line

from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs


def lines(case: PharmaCase) -> list[str]:
    """A case in a few lines, one for each aspect of it, for the user to check."""
    inputs = pharma_inputs(case)
    rows = [
        f"{case.title}: {' -> '.join(unit.name for unit in case.units)}",
        f"{counted(len(case.network.reactions), 'reaction')} among {len(case.network.species)} "
        "species; each reaction conserves mass",
        inputs_line([entry.value.size for entry in inputs.values()]),
        f"{len(case.parameters)} process parameters, {len(case.attributes)} quality attributes",
        f"integration over time by the method {case.numerics.method}",
    ]
    if case.optimise is not None:
        rows.append(f"{len(case.optimise.decisions)} numbers are chosen for the best recipe")
    if case.control is not None:
        rows.append(f"a policy decides {', '.join(m.input for m in case.control.manipulated)}")
    return rows
