"""Sources of the variance of the final funding ratio: each source of risk taken away in turn.

The trained policy decides throughout, on the same paths; only the volatilities of one source are
zero. Shares need not add up to one: sources offset each other, and the policy reacts.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.given import Given
from snapo.solver.evaluate import path_totals
from snapo.study.study import StudyRun

from ..records.case import PensionCase
from ..records.inputs import every_given
from .setup import case_of

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


def work(run: StudyRun) -> dict[str, Any]:
    """ "variance": mean and standard deviation of the final ratio, all in, and without each
    source."""
    case, setup, policy = case_of(run), run.setup, run.solution.policy
    assert policy is not None
    if case.scenarios is not None:
        return {"variance": []}
    paths, risks = min(PATHS, setup.evaluation.paths), sources(case)
    # Numbers that the case holds fixed move too: all are inputs, so that one program serves.
    every = {each.name: each.input() for volatilities in risks.values() for each in volatilities}
    problem = replace(setup.problem, inputs=every | setup.problem.inputs)

    def final(zeros: list[Given]) -> np.ndarray:
        moved = problem.at({each.name: 0 * each.values for each in zeros})
        totals = path_totals(moved, policy, paths, engine=setup.engines.evaluate)
        return totals["funding_ratio"]

    base = final([])
    rows = [{"source": "All sources", "mean": base.mean(), "deviation": base.std()}]
    for name, volatilities in risks.items():
        present = [each for each in volatilities if each.values.any()]
        if present:
            left = final(present)
            row = {"source": f"Without {name}", "mean": left.mean()}
            row |= {"deviation": left.std(), "explained": 1 - left.var() / base.var()}
            rows.append(row)
    return {"variance": rows}
