"""A case in yearly steps beside itself in monthly ones: the difference that the grid makes."""

from dataclasses import replace

import numpy as np

from snapo.problem.inputs import plain

from ...records.case import PensionCase
from ...records.inputs import pension_inputs
from .reconcile import Figures, figures

MONTHS = 12
WORTH_TELLING = 0.002  # of the liability


def against_months(case: PensionCase, found: Figures) -> list[str]:
    """A remark where payments by month are worth noticeably more or less than those by year.

    Only of cohorts: cash flows come at the times that the actuary gives.
    """
    if case.step != 1 or case.members is None or not found.liability:
        return []
    # One decision will do: the liability today does not depend on the horizon.
    held = replace(case, step=1 / MONTHS, steps=MONTHS, plan=replace(case.plan, accruing=False))
    monthly = figures(held, plain(pension_inputs(case))).liability
    change = found.liability / monthly - 1
    if np.abs(change) < WORTH_TELLING:
        return []
    when = "ends" if case.plan.timing == "arrears" else "beginnings"
    return [
        f"with yearly steps benefits are paid at the {when} of years: the liability differs by "
        f"{change:+.1%} from that of monthly steps, as in the fund's own valuation perhaps "
        '(step = "month")'
    ]
