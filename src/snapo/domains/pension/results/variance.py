"""Sources of the variance of the final funding ratio: each source of risk taken away in turn.

The trained policy decides throughout, on the same paths; only the volatilities of one source are
zero. Shares need not add up to one: sources offset each other, and the policy reacts.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.case.given import Given
from snapo.problem.policy import Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import path_totals

from ..records.case import PensionCase
from ..records.inputs import every_given

if TYPE_CHECKING:
    from ..run import Problem

PATHS = 4096


def sources(case: PensionCase) -> dict[str, list[Given]]:
    """The volatilities of each source of risk that a case has."""
    records = {
        "interest rates": case.rates,
        "inflation and wages": case.inflation,
        "asset prices": case.assets,
        "credit spreads": case.credit,
        "currencies": case.currencies,
        "mortality": case.lee_carter,
    }
    return {
        name: [each for each in every_given(record) if each.group == "volatility"]
        for name, record in records.items()
        if record is not None
    }


def variance_by_source(
    problem: "Problem", policy: Policy, source: Scenarios
) -> list[dict[str, Any]]:
    """Mean and standard deviation of the final ratio, all in, and without each source."""
    if problem.case.scenarios is not None:
        return []
    paths = min(PATHS, problem.evaluation.paths)

    def final(zeros: list[Given]) -> np.ndarray:
        none = {each.name: replace(each, values=0 * each.values).input() for each in zeros}
        schedule = prepare(problem.simulator, problem.inputs | none)
        totals = path_totals(
            problem.engines.evaluate, problem.simulator, policy, schedule, source, paths, Exact()
        )
        return totals["funding_ratio"]

    base = final([])
    rows = [{"source": "All sources", "mean": base.mean(), "deviation": base.std()}]
    for name, volatilities in sources(problem.case).items():
        present = [each for each in volatilities if each.values.any()]
        if present:
            left = final(present)
            row = {"source": f"Without {name}", "mean": left.mean()}
            row |= {"deviation": left.std(), "explained": 1 - left.var() / base.var()}
            rows.append(row)
    return rows
