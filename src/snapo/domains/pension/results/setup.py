"""A pension case made ready to solve: its problem, policy and engines, and the output that measures
success."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from snapo.case.objective import make_objective
from snapo.problem.objective import Objective, Weighted
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Sources, Supplied
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.study.ready import engines_for
from snapo.study.study import Setup, StudyRun

from ..policies.allocation import new_policy
from ..pots.simulator import simulator_of
from ..records.case import PensionCase, PensionModel
from ..records.inputs import pension_inputs
from ..records.market import SuppliedScenarios


class OutcomeMeasure(NamedTuple):
    """The output that summarises a fund: a ratio with the target 1. `mean`, `tail`, `below`: the
    names of its mean, of the mean of its worst 5 %, and of the probability that it is below 1."""

    output: str
    mean: str
    tail: str
    below: str


FUNDING = OutcomeMeasure(
    "funding_ratio",
    "Mean funding ratio",
    "Funding ratio, mean of the worst 5 %",
    "Probability of F < 1",
)
PENSION = OutcomeMeasure(
    "pension",
    "Mean pension divided by today's",
    "Pension divided by today's, mean of the worst 5 %",
    "Probability of a pension below today's",
)


def outcome_measure(case: PensionModel) -> OutcomeMeasure:
    """The funding ratio; for a fund of personal pots the mean pension divided by that of today."""
    return FUNDING if case.pots is None else PENSION


def make_setup(case: PensionCase, engine: str = "auto") -> Setup:
    """The problem of a case, its untrained policy, its settings and its engines."""
    training = TrainingPlan.from_settings(case.training.model_dump())
    evaluation = Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    if case.scenarios is not None:
        sources = _divided(case.scenarios, training.seed)
    simulator = simulator_of(case)
    problem = Problem(simulator, pension_inputs(case), objective_of(case), sources)
    policy = new_policy(case, simulator, problem.schedule, jax.random.key(training.seed))
    engines = engines_for(engine, problem, policy)
    return Setup(problem, policy, training, evaluation, engines, case=case)


def setup_at(setup: Setup, case: PensionCase, engine: str) -> Setup:
    """The setup of another case, equal to that of `make_setup`.

    Nothing is compiled if the case has the same form.
    """
    problem = replace(setup.problem, simulator=simulator_of(case), inputs=pension_inputs(case))
    if problem.form != setup.problem.form:
        return make_setup(case, engine)
    return setup._replace(problem=problem, case=case)


def case_of(run: StudyRun) -> PensionCase:
    """The case of a run."""
    return case_in(run.setup)


def case_in(setup: Setup) -> PensionCase:
    """The case of a problem that was set up."""
    assert isinstance(setup.case, PensionCase)
    return setup.case


def objective_of(case: PensionCase) -> Objective:
    """The sum of the case's terms."""
    terms = [(term.weight, make_objective(term.objective, term.output)) for term in case.objective]
    if len(terms) == 1 and terms[0][0] == 1:
        return terms[0][1]
    return Weighted(*terms)


def _divided(scenarios: SuppliedScenarios, seed: int) -> Sources:
    """The sources of ready-made paths: four fifths of the paths for training train, the others
    validate."""
    training, evaluation = (
        Supplied(np.ascontiguousarray(np.swapaxes(paths, 0, 1)), seed=seed)
        for paths in (scenarios.training, scenarios.evaluation)
    )
    edge = max(1, training.size * 4 // 5)
    return Sources(training.part(0, edge), training.part(edge, training.size), evaluation)
