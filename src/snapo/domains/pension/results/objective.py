"""The terms of the objective, and its value as a sure ratio."""

from typing import Any

from snapo.study.study import StudyRun

from .compare import equivalent
from .setup import case_of


def work(run: StudyRun) -> dict[str, Any]:
    """ "objective": its terms and value; under a utility of the funding ratio, or of pensions over
    today's, also the certainty equivalent of this `output` with its standard error."""
    solution, objective = run.solution, run.setup.problem.objective
    terms = [
        {"weight": t.weight, "output": t.output, "kind": t.objective.kind}
        for t in case_of(run).objective
    ]
    found: dict[str, Any] = {"terms": terms, "value": solution.value}
    known = equivalent(objective, solution.value)
    if known is not None:
        found |= {"equivalent": known.ratio, "slope": known.slope}
        found["output"] = objective.output  # pyright: ignore
        found["equivalent_error"] = known.slope * solution.standard_error
        found["aversion"] = objective.utility.risk_aversion  # pyright: ignore
    return {"objective": found}
