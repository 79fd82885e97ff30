"""Deltas by delivery day and month, beside the volumes of the intrinsic plan."""

from typing import Any

import numpy as np

from snapo.solver.solution import Solution

from ..problem import Problem
from ..references.intrinsic import Plan


def deltas(
    problem: Problem, solution: Solution, plan: Plan
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """By day and by delivery month: discounted, and as volumes of undiscounted futures."""
    case, steps = problem.case, problem.schedule.steps
    table, days, curve = solution.sensitivities, len(case.days), case.market.forward_curve.name
    if table is None:
        return {}, []
    found = table.held[curve]
    moved = np.zeros(found.value.size) if table.moved is None else table.moved[curve]
    smooth = None if table.smooth is None else table.smooth[curve]
    sold = -plan.net * np.where(plan.net < 0, 1 - steps.withdrawal_fuel, 1 + steps.injection_fuel)
    rate = np.ones(found.value.size)
    rate[:days] = steps.gas_discount
    daily = {
        "discounted": found.value[:days],
        "standard_error": found.standard_error[:days],
        "undiscounted": (found.value / rate)[:days],
        "moved": moved[:days],
        "intrinsic": sold,
    }
    months = np.array([day.strftime("%Y-%m") for day in case.days])
    monthly = []
    for month in dict.fromkeys(months):
        chosen = np.zeros(found.value.size)
        chosen[:days] = months == month
        value, error = found.along(chosen)
        monthly.append(
            {
                "month": month,
                "discounted": value,
                "standard_error": error,
                "undiscounted": found.along(chosen / rate)[0],
                "moved": float(moved @ chosen),
                "smooth": None if smooth is None else smooth.along(chosen)[0],
                "intrinsic": float(sold @ chosen[:days]),
            }
        )
    return daily, monthly
