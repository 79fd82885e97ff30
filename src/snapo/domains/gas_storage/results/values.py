"""Values of the same contract on the same curve, side by side, and the spread of its earnings."""

from typing import Any

import numpy as np

from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import estimate, path_totals
from snapo.solver.solution import Solution

from ..contract.expiry import fixed_costs_value
from ..policy.network import GuidePolicy
from ..problem import OUTPUT, Problem
from .profile import working_volume

PATHS = 16384
QUANTILES = (1, 5, 25, 50, 75, 95, 99)


def values(
    problem: Problem, solution: Solution, source: Scenarios, known: dict[str, float | None]
) -> dict[str, Any]:
    """The value ladder, fixed costs, the break-even fee and the distribution of the cash flow."""
    return {
        "fixed_costs": fixed_costs_value(problem.case),
        "break_even_fee": _break_even_fee(problem, solution),
        "value_ladder": _ladder(problem, solution, source, known),
        "cash_flow": _distribution(np.asarray(solution.totals[OUTPUT])),
    }


def _ladder(problem: Problem, solution: Solution, source: Scenarios, known) -> list[dict[str, Any]]:
    """Intrinsic, the guide's rule, the trained policy, the reference, and after fixed costs."""
    paths = problem.case.model.paths(PATHS)
    given = (problem.engines.evaluate, problem.simulator, GuidePolicy(), problem.schedule, source)
    totals = path_totals(*given, paths, Exact())
    guide = estimate(problem.objective, totals, source, problem.simulator.control_variates())

    def rung(name, value, error=None, note=""):
        return {"name": name, "value": value, "standard_error": error, "note": note}

    error = solution.standard_error
    ladder = [
        rung("Intrinsic", known["intrinsic"], note="best fixed plan against today's curve"),
        rung("One-factor rule", *guide[:2], note="dynamic program in the fastest factor alone"),
        rung("Trained policy", solution.value, error, "exact simulator, fresh paths"),
    ]
    if known.get("dynamic_programming") is not None:
        note = "lattice in at most two price factors"
        ladder.append(rung("Dynamic programming", known["dynamic_programming"], note=note))
    fees = fixed_costs_value(problem.case)
    if fees:
        after = solution.value - fees
        ladder.append(rung("After fixed costs", after, error, "less their present value"))
    return ladder


def _break_even_fee(problem: Problem, solution: Solution) -> float:
    """The fee per unit of working volume, paid today, at which the contract is worth nothing."""
    volume = working_volume(problem.case)
    return solution.value / volume if volume > 0 else float("nan")


def _distribution(cash: np.ndarray) -> dict[str, Any]:
    counts, edges = np.histogram(cash, bins=60)
    return {
        "edges": edges,
        "counts": counts,
        "mean": cash.mean(),
        "standard_deviation": cash.std(),
        "quantiles": {str(q): np.quantile(cash, q / 100) for q in QUANTILES},
    }
