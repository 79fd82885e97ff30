"""A case made ready to solve: simulator with guide and hedge, inputs, schedule, engines."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from snapo.case.settings import make_objective
from snapo.engine import Engines, choose
from snapo.problem.inputs import Input
from snapo.problem.objective import Mean, Objective
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Pseudo, Scenarios
from snapo.problem.simulator import Schedule, probe
from snapo.solver import solve as solver
from snapo.solver.sensitivity import sensitivities
from snapo.solver.train import EVALUATE_STREAM, Training

from .contract.inputs import storage_inputs
from .contract.records import StorageCase
from .contract.schedule import of_prices
from .contract.simulator import StorageSimulator
from .policy.network import GuidePolicy, StoragePolicy
from .policy.value_table import ValueTable
from .prices.process import GaussianFactors
from .references.marginal import marginal_values

OUTPUT = "cash_flow"
HEDGE_PATHS = 2048


class Problem(NamedTuple):
    """A case made ready to solve."""

    case: StorageCase
    simulator: StorageSimulator
    inputs: dict[str, Input]
    schedule: Schedule
    objective: Objective
    training: Training
    evaluation: solver.Evaluation
    engines: Engines

    @property
    def interpolation(self):
        return self.case.contract.ratchets.interpolation

    @property
    def factors(self) -> GaussianFactors | None:
        """The price factors that a dynamic program can use."""
        return self.simulator.process.factors(of_prices(self.schedule))

    def source(self) -> Scenarios:
        """Scenarios for what is measured beside the value."""
        own = self.case.model.supplied("evaluation")
        return own or Pseudo(self.training.seed, stream=(EVALUATE_STREAM << 32) + 1)

    def sensitivity_source(self) -> Scenarios:
        """The scenarios on which the value and the sensitivities were measured."""
        own = self.case.model.supplied("evaluation")
        return own or self.evaluation.source(self.training.seed)


def make_problem(case: StorageCase, seed: int, engine: str = "auto") -> Problem:
    """Simulator with its guide and its hedge, inputs, schedule, objective and engines."""
    inputs, process = storage_inputs(case), case.model
    schedule = prepare(StorageSimulator(case), inputs)  # pyright: ignore[reportCallIssue]
    factors = process.factors(of_prices(schedule))
    found = marginal_values(schedule, factors, case.contract.ratchets.interpolation)
    # No hedge yet, but its place: the compiled `prepare` serves before and after.
    no_hedge = np.zeros(len(case.days))
    simulator = StorageSimulator(case, ValueTable.of(found), no_hedge)  # pyright: ignore
    schedule = prepare(simulator, inputs)
    training = Training(**case.training.model_dump() | {"seed": seed})
    evaluation = solver.Evaluation(**case.evaluation.model_dump())
    evaluation = replace(evaluation, paths=process.paths(evaluation.paths))
    policy = StoragePolicy(probe(simulator, schedule)[1].shape[0], key=jax.random.key(seed))
    engines = choose(engine, simulator, policy, schedule)
    if process.martingale:
        simulator = replace(simulator, hedge=_hedge(simulator, inputs, engines, seed))
        schedule = prepare(simulator, inputs)
    objective = make_objective(case.objective, OUTPUT)
    return Problem(case, simulator, inputs, schedule, objective, training, evaluation, engines)


def _hedge(simulator: StorageSimulator, inputs, engines: Engines, seed: int) -> np.ndarray:
    """Forward volumes [T] for the control variate: the deltas of the guide's rule."""
    source = Pseudo(seed, stream=(EVALUATE_STREAM << 32) + 2)
    rule = GuidePolicy()
    found = sensitivities(
        simulator, inputs, rule, Mean(OUTPUT), source, HEDGE_PATHS, engine=engines.evaluate
    )
    discount = prepare(simulator, inputs).steps.gas_discount
    curve = simulator.case.market.forward_curve.name
    return found.held[curve].value[: simulator.horizon] / discount


def new_policy(problem: Problem) -> StoragePolicy:
    """The untrained policy: the guide's rule, nearly."""
    features = probe(problem.simulator, problem.schedule)[1].shape[0]
    return StoragePolicy(features, key=jax.random.key(problem.training.seed))
