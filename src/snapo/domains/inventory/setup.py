"""A case made ready to solve: the problem, its policy and its engines."""

import jax
import numpy as np
from scipy import stats

from snapo.case.objective import make_objective
from snapo.engine import EngineName
from snapo.problem.inputs import Input
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.study.ready import at_values, engines_for
from snapo.study.study import Setup

from .item.estimates import economic_lot, mean_demand, safety_factor, usual_deviation
from .item.records import InventoryCase
from .item.simulator import InventorySimulator, inputs_of
from .network.estimates import first_batches
from .network.inputs import network_inputs
from .network.policy import EchelonRule
from .network.records import NetworkCase
from .network.simulator import NetworkSimulator
from .policy.order_up_to import OrderUpTo

AnyCase = InventoryCase | NetworkCase


def make_setup(case: AnyCase, engine: EngineName = "auto") -> Setup:
    """Simulator, scenarios, policy and engines."""
    training = TrainingPlan.from_settings(case.training.model_dump())
    evaluation = Evaluation(**case.evaluation.model_dump())
    objective = make_objective(case.objective, "result")
    sources = evaluation.sources(training.seed)
    problem = Problem(simulator_of(case), case_inputs(case), objective, sources)
    policy = first_policy(problem, case, training.seed)
    engines = engines_for(engine, problem, policy)
    return Setup(problem, policy, training, evaluation, engines)


def setup_at(setup: Setup, case: AnyCase) -> Setup:
    """The setup of a case that differs in the numbers of its inputs alone: `make_setup(case)`."""
    values = {name: entry.value for name, entry in case_inputs(case).items()}
    engine: EngineName = setup.engines.name  # pyright: ignore[reportAssignmentType]
    return at_values(setup, simulator_of(case), values, lambda: make_setup(case, engine))


def simulator_of(case: AnyCase) -> InventorySimulator | NetworkSimulator:
    """The simulator of an item, or that of a network."""
    if isinstance(case, NetworkCase):
        return NetworkSimulator(case)  # pyright: ignore[reportCallIssue]
    return InventorySimulator(case)  # pyright: ignore[reportCallIssue]


def case_inputs(case: AnyCase) -> dict[str, Input]:
    """Every number of a case that has a sensitivity."""
    return network_inputs(case) if isinstance(case, NetworkCase) else inputs_of(case)


def first_policy(problem: Problem, case: AnyCase, seed: int) -> OrderUpTo | EchelonRule:
    """The base-stock rule; where an order has a cost, an (s, S) rule with the economic lot."""
    key = jax.random.key(seed)
    if isinstance(case, NetworkCase):
        batch, wait = first_batches(case)
        return EchelonRule(case, problem.action, problem.features, key=key, batch=batch, wait=wait)
    batch, wait = first_batch(case) if case.item.fixed else (0.0, 0.0)
    return OrderUpTo(problem.action, problem.features, key=key, batch=batch, wait=wait)


def first_batch(case: InventoryCase) -> tuple[float, float]:
    """How far S lies above and s below the base-stock level, in standard deviations of demand.

    With an economic lot Q, stock runs short in the share h Q / (p mean + h Q) of its cycles; an
    order is placed half a period's demand too late on average. S = s + Q less that half.
    """
    item, mean, deviation = case.item, mean_demand(case), usual_deviation(case)
    lot, half = economic_lot(case), mean / 2
    held = item.cost("holding") * lot
    ratio = 1 - held / (item.cost("shortage") * mean + held)
    periods = item.lead_time + 1
    below = (safety_factor(case) - float(stats.norm.ppf(ratio))) * np.sqrt(periods) * deviation
    wait = below + half
    return float(lot - wait - half) / deviation, float(wait) / deviation


def case_of(setup: Setup) -> InventoryCase:
    """The item that was made ready."""
    simulator = setup.problem.simulator
    assert isinstance(simulator, InventorySimulator)
    return simulator.case


def network_of(setup: Setup) -> NetworkCase:
    """The network that was made ready."""
    simulator = setup.problem.simulator
    assert isinstance(simulator, NetworkSimulator)
    return simulator.case
