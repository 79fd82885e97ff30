"""The value of the objective: its terms, and the certainty-equivalent ratio."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.problem.objective import CRRA, ExpectedUtility, Objective
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..results.setup import FUNDING, PENSION, case_of


class Equivalent(NamedTuple):
    """The certain `ratio` that has a given utility; the ratio is the final funding ratio, or the
    mean pension divided by today's. `slope` is d ratio / d utility."""

    ratio: float
    slope: float


NAMES = {FUNDING.output: "funding ratio", PENSION.output: "pension"}


def headline_name(objective: Objective) -> str:
    """The name of the certainty equivalent; empty for objectives that have none."""
    if not isinstance(objective, ExpectedUtility) or objective.output not in NAMES:
        return ""
    return f"Certainty-equivalent {NAMES[objective.output]}"


def equivalent(objective: Objective, utility: float) -> Equivalent | None:
    """The certainty equivalent of the final ratio; None if the objective is not a utility of this
    ratio."""
    if not (isinstance(objective, ExpectedUtility) and objective.output in NAMES):
        return None
    crra: CRRA = objective.utility
    ratio = crra.certainty_equivalent(utility)
    if not math.isfinite(ratio):
        return None
    return Equivalent(ratio, 1 / float(crra.slope(np.array(ratio))))


@dataclass(frozen=True)
class WeightedTerm:
    """A term of the objective: its weight, its output, and its kind."""

    weight: Number = np.nan
    output: str = ""
    kind: str = ""


@dataclass(frozen=True)
class ObjectiveValue:
    """The terms of the objective and its value. `equivalent`, `equivalent_error`: the certainty
    equivalent of this `output` with its standard error, if the objective is a utility of the
    funding ratio, or of pensions relative to today's. `slope`: the derivative of the equivalent
    with respect to the utility, whose relative risk aversion is `aversion`.
    """

    terms: tuple[WeightedTerm, ...] = ()
    value: Number = np.nan
    equivalent: Number = np.nan
    slope: Number = np.nan
    output: str | None = None
    equivalent_error: Number = np.nan
    aversion: Number = np.nan


def measure(run: StudyRun) -> ObjectiveValue:
    """The objective of the case, with the value of the run."""
    solution, objective = run.solution, run.setup.problem.objective
    terms = tuple(
        WeightedTerm(term.weight, term.output, term.objective.kind)
        for term in case_of(run).objective
    )
    certain = equivalent(objective, solution.value)
    if certain is None or not isinstance(objective, ExpectedUtility):
        return ObjectiveValue(terms, solution.value)
    error = certain.slope * solution.standard_error
    aversion = objective.utility.risk_aversion  # pyright: ignore
    return ObjectiveValue(
        terms, solution.value, certain.ratio, certain.slope, objective.output, error, aversion
    )


OBJECTIVE = Chapter(
    "objective", "Objective", ObjectiveValue, measure, lambda run, value: [], key="objective"
)
