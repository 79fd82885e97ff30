"""Everything that the report of a storage run shows, as plain data (`details.json`)."""

from typing import Any

from snapo.solver.solution import Solution

from ..problem import Problem
from ..references.intrinsic import Plan
from .certificate import certificate
from .deltas import deltas
from .described import described
from .profile import profile
from .shadow_prices import shadow_prices
from .values import values


def details(
    problem: Problem, solution: Solution, plan: Plan, known: dict[str, float | None]
) -> dict[str, Any]:
    """All figures and tables of the report; volumes and money in the case's own units."""
    case, source = problem.case, problem.source()
    daily, monthly = deltas(problem, solution, plan)
    return {
        "title": case.title,
        "currency": case.currency,
        "volume_unit": case.volume_unit,
        "valuation_date": case.valuation_date.isoformat(),
        "start": case.start.isoformat(),
        "end": case.end.isoformat(),
        "days": [day.isoformat() for day in case.days],
        "model": case.model.words(),
        "notes": list(case.notes),
        "forward": problem.schedule.steps.forward,
        "inputs": described(problem.inputs),
        **values(problem, solution, source, known),
        **profile(problem, solution, source),
        "deltas_daily": daily,
        "deltas_monthly": monthly,
        "shadow_prices": shadow_prices(problem, solution.policy, source),
        "certificate": certificate(problem, solution, source),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "seed": solution.seed,
        "engine": {"name": solution.engine, "reason": solution.reason},
        "paths": dict(solution.paths),
    }
