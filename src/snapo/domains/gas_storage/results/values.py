"""Values of the same contract on the same curve, side by side, and the spread of its earnings."""

from typing import Any

import numpy as np

from snapo.solver.evaluate import Value, evaluate
from snapo.solver.solution import Solution
from snapo.study.study import Part, Setup, StudyRun

from ..contract.records import StorageCase
from ..contract.simulator import simulator_of
from ..policy.fitted_guide import FittedKnots
from ..setup import OUTPUT, beside, case_of, policy_of
from .profile import working_volume

PATHS = 16384
QUANTILES = (1, 5, 25, 50, 75, 95, 99)


def work(run: StudyRun) -> dict[str, Any]:
    """The value ladder, the break-even fee and the distribution of the cash flow."""
    solution, case = run.solution, case_of(run.setup)
    return {
        "break_even_fee": _break_even_fee(case, solution),
        "value_ladder": _ladder(run, solution),
        "cash_flow": _distribution(np.asarray(solution.totals[OUTPUT])),
    }


VALUES = Part("value ladder", work, needs=("intrinsic value", "training"))


def _ladder(run: StudyRun, solution: Solution) -> list[dict[str, Any]]:
    """Intrinsic, the guide's rule, the trained policy, the reference, and after fixed costs."""
    engine = run.setup.engines.evaluate
    guide = evaluate(beside(run.setup), policy_of(solution).guide, paths=PATHS, engine=engine)

    error, plan = solution.standard_error, run.get("intrinsic.value")
    ladder = [
        _rung("Intrinsic", plan, note="best fixed plan against today's curve"),
        _guide_rung(run.setup, guide),
        _rung("Trained policy", solution.value, error, "exact simulator, fresh paths"),
    ]
    exact, fees = run.get("dynamic_programming"), run.get("fixed_costs")
    if exact is not None:
        error = run.get("dynamic_programming_error", 0.0)
        note = f"lattice in at most two price factors; finer grids move it by {error:,.2g}"
        ladder.append(_rung("Dynamic programming", exact, note=note))
    above = run.get("bound.upper")
    if above is not None:
        note = "hindsight with a penalty: no policy earns more"
        if little := run.get("bound.says_little"):
            note = f"{note}; {little}"
        ladder.append(_rung("Upper bound", above["value"], above["standard_error"], note))
    if fees:
        after = solution.value - fees
        ladder.append(_rung("After fixed costs", after, error, "less their present value"))
    return ladder


def _rung(name, value, error=None, note="") -> dict[str, Any]:
    return {"name": name, "value": value, "standard_error": error, "note": note}


def _guide_rung(setup: Setup, worth: Value) -> dict[str, Any]:
    """What the guide earns before any training."""
    guide = simulator_of(setup.problem).guide
    if guide is not None and isinstance(guide.knots, FittedKnots):
        name, note = "Fitted rule", "value iteration in the price factors, before training"
    else:
        name, note = "One-factor rule", "dynamic program in the fastest factor alone"
    return _rung(name, worth.value, worth.standard_error, note)


def _break_even_fee(case: StorageCase, solution: Solution) -> float:
    """The fee per unit of working volume, paid today, at which the contract is worth nothing."""
    volume = working_volume(case)
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
