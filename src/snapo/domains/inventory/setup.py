"""Prepares a case to be solved: the problem, its policy and its engines."""

from dataclasses import replace

import jax
import numpy as np
from scipy.special import ndtri

from snapo.case.objective import make_objective
from snapo.engine import EngineName
from snapo.problem.problem import Problem
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.study.ready import engines_for
from snapo.study.study import Setup

from .item.estimates import economic_lot, mean_demand, safety_factor, usual_deviation
from .item.records import InventoryCase
from .item.simulator import InventorySimulator
from .network.estimates import first_batches
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
    problem = Problem(simulator_of(case), case.inputs(), objective, sources)
    policy = first_policy(problem, case, training.seed)
    engines = engines_for(engine, problem, policy)
    return Setup(problem, policy, training, evaluation, engines, case=case)


def setup_at(setup: Setup, case: AnyCase) -> Setup:
    """The setup of a case that differs only in the numbers of its inputs: `make_setup(case)`.

    If the case has the same form, nothing is compiled.
    """
    problem = replace(setup.problem, simulator=simulator_of(case), inputs=case.inputs())
    if problem.form != setup.problem.form:
        return make_setup(case, setup.engines.name)  # pyright: ignore[reportArgumentType]
    policy = first_policy(problem, case, setup.training.seed)
    return setup._replace(problem=problem, policy=policy, case=case)


def simulator_of(case: AnyCase) -> InventorySimulator | NetworkSimulator:
    """The simulator of an item or of a network."""
    if isinstance(case, NetworkCase):
        return NetworkSimulator.of(case)
    return InventorySimulator.of(case)


def first_policy(problem: Problem, case: AnyCase, seed: int) -> OrderUpTo | EchelonRule:
    """The base-stock rule or, if an order has a cost, an (s, S) rule with the economic lot."""
    key = jax.random.key(seed)
    if isinstance(case, NetworkCase):
        batch, wait = first_batches(case)
        return EchelonRule(
            case.network, problem.action, problem.features, key=key, batch=batch, wait=wait
        )
    batch, wait = first_batch(case) if case.item.fixed else (0.0, 0.0)
    return OrderUpTo(problem.action, problem.features, key=key, batch=batch, wait=wait)


def first_batch(case: InventoryCase) -> tuple[float, float]:
    """The distance of S above and of s below the base-stock level, in standard deviations of
    demand. With an economic lot Q, stock runs short in the share h Q / (p mean + h Q) of its
    cycles. When an order is placed, the position is on average half a period's demand below s, so S
    = s + Q minus half a period's demand.
    """
    item, mean, deviation = case.item, mean_demand(case), usual_deviation(case)
    lot, half = economic_lot(case), mean / 2
    held = item.cost("holding") * lot
    ratio = 1 - held / (item.cost("shortage") * mean + held)
    periods = item.lead_time + 1
    below = (safety_factor(case) - float(ndtri(ratio))) * np.sqrt(periods) * deviation
    wait = below + half
    return float(lot - wait - half) / deviation, float(wait) / deviation


def case_of(setup: Setup) -> InventoryCase:
    """The case of a prepared item."""
    assert isinstance(setup.case, InventoryCase)
    return setup.case


def network_of(setup: Setup) -> NetworkCase:
    """The case of a prepared network."""
    assert isinstance(setup.case, NetworkCase)
    return setup.case
