"""A case with places made ready to solve."""

import jax

from snapo.case.objective import make_objective
from snapo.engine import EngineName
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.study.ready import at_values, engines_for
from snapo.study.study import Setup

from .estimates import first_batches
from .inputs import network_inputs
from .policy import EchelonRule
from .records import NetworkCase
from .simulator import NetworkSimulator


def make_setup(case: NetworkCase, engine: EngineName = "auto") -> Setup:
    """Simulator, scenarios, policy and engines."""
    training = TrainingPlan.given(case.training.model_dump())
    evaluation = Evaluation(**case.evaluation.model_dump())
    simulator = NetworkSimulator(case)  # pyright: ignore[reportCallIssue]
    sources = evaluation.sources(training.seed)
    objective = make_objective(case.objective, "result")
    problem = Problem(simulator, network_inputs(case), objective, sources)
    key = jax.random.key(training.seed)
    batch, wait = first_batches(case)
    policy = EchelonRule(case, problem.action, problem.features, key=key, batch=batch, wait=wait)
    engines = engines_for(engine, problem, policy)
    return Setup(problem, policy, training, evaluation, engines)


def moved_setup(setup: Setup, case: NetworkCase) -> Setup:
    """The setup of a case that differs in the numbers of its inputs alone: `make_setup(case)`."""
    simulator = NetworkSimulator(case)  # pyright: ignore[reportCallIssue]
    values = {name: given.value for name, given in network_inputs(case).items()}
    engine: EngineName = setup.engines.name  # pyright: ignore[reportAssignmentType]
    return at_values(setup, simulator, values, lambda: make_setup(case, engine))


def network_of(setup: Setup) -> NetworkCase:
    """The case that was made ready."""
    simulator = setup.problem.simulator
    assert isinstance(simulator, NetworkSimulator)
    return simulator.case
