"""The case in a few lines, and its reconciliation with the actuary's own figures."""

from snapo.case.error import CaseError
from snapo.problem.inputs import plain

from ..records.case import PensionCase
from ..records.inputs import pension_inputs
from .reconcile import Line
from .reconcile import check as reconcile

SCENARIOS = {"P": "P (real-world)", "Q": "Q (risk-neutral)"}


def lines(case: PensionCase) -> list[str]:
    """Horizon, inputs and figures of a case: nothing is trained."""
    inputs = pension_inputs(case)
    numbers = sum(entry.value.size for entry in inputs.values())
    found = [
        f"{case.title}: {case.steps} decisions over {case.steps * case.step:g} years, "
        f"{len(case.assets.classes)} classes, {case.buckets} swap tenors",
        f"scenarios: {'supplied' if case.scenarios else SCENARIOS[case.measure]}",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity; "
        f"{len(case.held)} held",
    ]
    for line in reconciled(case):
        known = "" if line.given is None else f", given {line.given:,.6g}"
        found.append(f"{line.name}: {line.own:,.6g}{known}")
    return found


def reconciled(case: PensionCase) -> list[Line]:
    """The lines of the reconciliation.

    **Raises:** `CaseError` where a figure of the actuary's is missed by more than its tolerance.
    """
    found = reconcile(case, plain(pension_inputs(case)))
    for line in found:
        if not line.ok and line.given is not None and case.reconcile is not None:
            tolerance = case.reconcile.tolerance
            what = (
                f"this model's own figure is {line.own:.8g}, which differs by {line.error:.3g}; "
                f"the tolerance is {tolerance:g}"
            )
            raise CaseError(str(case.file), f"reconcile.{line.name}", line.given, what)
    return found
