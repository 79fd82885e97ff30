"""Where the spread of the final funding ratio comes from: each source of risk taken away in turn.

The trained policy decides throughout, on the same paths; only the volatilities of one source are
zero. Shares need not add up to one: sources offset each other, and the policy reacts.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.problem.inputs import Input
from snapo.problem.policy import Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import path_totals

from .inputs import every_given

if TYPE_CHECKING:
    from .run import Problem

PATHS = 4096
SOURCES = {
    "Interest rates": ("rate_volatility",),
    "Inflation and wages": ("inflation_volatility", "index_volatility", "wage_volatility"),
    "Asset prices": ("asset_volatility",),
    "Credit spreads": ("credit_volatility",),
    "Currencies": ("currency_volatility",),
    "Mortality": ("lee_carter_volatility",),
}


def spread(problem: "Problem", policy: Policy, source: Scenarios) -> list[dict[str, Any]]:
    """Mean and standard deviation of the final ratio, all in, and without each source."""
    if problem.case.scenarios is not None:
        return []
    given = {each.name: each for each in every_given(problem.case)}
    paths = min(PATHS, problem.evaluation.paths)

    def final(zeros: tuple[str, ...]) -> np.ndarray:
        none = {
            name: Input(0 * given[name].values, given[name].unit, given[name].labels)
            for name in zeros
        }
        schedule = prepare(problem.simulator, problem.inputs | none)
        totals = path_totals(
            problem.engines.evaluate, problem.simulator, policy, schedule, source, paths, Exact()
        )
        return totals["funding_ratio"]

    base = final(())
    rows = [{"source": "All sources", "mean": base.mean(), "deviation": base.std()}]
    for name, inputs in SOURCES.items():
        present = tuple(each for each in inputs if each in given and given[each].values.any())
        if present:
            left = final(present)
            row = {"source": f"Without {name.lower()}", "mean": left.mean()}
            row |= {"deviation": left.std(), "explained": 1 - left.var() / base.var()}
            rows.append(row)
    return rows
