"""Prepares a case for the solver: the problem with its value table and its hedge, the policy and
the engines."""

from dataclasses import replace

import jax
import numpy as np

from snapo.case.objective import make_objective
from snapo.engine import EngineName
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.problem.smooth import Exact
from snapo.solver.derivatives.by_block import DerivativePass
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation
from snapo.study.ready import engines_for
from snapo.study.study import Setup

from .bounds.value_iteration import FittedValue, fit_value_table, fitted_marginal, innovation_table
from .contract.records import StorageCase, storage_inputs
from .contract.schedule import of_prices
from .contract.simulator import StorageSimulator, simulator_of
from .policy.network import StoragePolicy
from .policy.value_table import FittedKnots, Innovations, ValueTable
from .prices.process import GaussianFactors
from .references.lattice import coordinates
from .references.marginal import marginal_values

OUTPUT = "cash_flow"
HEDGE_PATHS = 2048
MAX_FACTORS = 3  # of a fitted value table, next to those that move all prices in proportion
BESIDE, HEDGE = 1, 2  # streams of the evaluation: of the figures next to the value, of the hedge


def bare_problem(case: StorageCase) -> Problem:
    """The contract without a value table and without a hedge."""
    simulator = StorageSimulator.of(case)
    return Problem(simulator, storage_inputs(case), make_objective(case.objective, OUTPUT))


def make_setup(
    case: StorageCase, engine: EngineName = "auto", fit: FittedValue | None = None
) -> Setup:
    """The simulator with its value table and its hedge, the scenarios, the policy and the
    engines."""
    evaluation, seed = Evaluation(**case.evaluation.model_dump()), case.training.seed
    problem = bare_problem(case)
    sources = case.model.sources(seed) or evaluation.sources(seed)
    problem = _with_value_table(replace(problem, sources=sources, rebuild=rebuilt), fit)
    fitted = simulator_of(problem).innovations is not None and case.objective.kind == "mean"
    training = TrainingPlan.from_settings(case.training.model_dump(), fitted)
    # Training begins with the value table: where margins are low, random corrections would lose.
    policy = StoragePolicy(problem.features, key=jax.random.key(seed)).value_rule
    engines = engines_for(engine, problem, policy)
    return _hedged(Setup(problem, policy, training, evaluation, engines, case=case))


def setup_at(setup: Setup, case: StorageCase) -> Setup:
    """The setup of a case that differs only in its numbers: `make_setup(case)`.

    Nothing is compiled if the case has the same form.
    """
    bare = bare_problem(case)
    if case.model.sources(setup.training.seed) or bare.form != _bare(setup.problem).form:
        return make_setup(case, setup.engines, fitted_value(bare))
    moved = replace(setup.problem, simulator=bare.simulator, inputs=bare.inputs)
    return _hedged(setup._replace(problem=rebuilt(moved), case=case))


def rebuilt(problem: Problem) -> Problem:
    """The problem with the value table and the scales of features of its inputs.

    The hedge, a control variate on which no value depends, is set to zero.
    """
    problem = _bare(problem)
    values = {name: inputs.value for name, inputs in problem.inputs_by_name.items()}
    problem = replace(problem, simulator=simulator_of(problem).scaled(values))
    return _with_value_table(problem, fitted_value(problem))


def _bare(problem: Problem) -> Problem:
    """The problem without a value table and without a hedge."""
    bare = replace(simulator_of(problem), value_table=None, hedge=None, innovations=None)
    return replace(problem, simulator=bare)


def _with_value_table(problem: Problem, fit: FittedValue | None) -> Problem:
    """The problem with its value table."""
    simulator = simulator_of(problem)
    # No hedge yet, but room for it: the compiled code serves before and after.
    adjacent = {"innovations": _innovations(problem, fit), "hedge": np.zeros(simulator.horizon)}
    return replace(
        problem, simulator=replace(simulator, value_table=value_table(problem, fit), **adjacent)
    )


def _innovations(problem: Problem, fit: FittedValue | None) -> Innovations | None:
    """The innovations of the fitted value, if prices have no risks other than its factors."""
    result = factors(problem)
    if fit is None or result is None or not result.exact or len(fit.basis.selected) > MAX_FACTORS:
        return None
    return Innovations.of(innovation_table(fit))


def _hedged(setup: Setup) -> Setup:
    """The setup with a hedge as its control variate, if it has no better control variate."""
    problem, simulator = setup.problem, simulator_of(setup.problem)
    if simulator.innovations is not None or not simulator.process.martingale:
        return setup
    hedged = replace(simulator, hedge=_hedge(setup))
    return setup._replace(problem=replace(problem, simulator=hedged))


def fitted_value(problem: Problem) -> FittedValue | None:
    """The fitted value for the value table and the control variate, if the factors are Gaussian."""
    result, kind = factors(problem), simulator_of(problem).interpolation
    return None if result is None else fit_value_table(problem.schedule, result, kind)


def value_table(problem: Problem, fit: FittedValue | None) -> ValueTable:
    """The marginal values: from the fitted value if several factors matter, otherwise from a
    dynamic program in the fast factor."""
    result, schedule = factors(problem), problem.schedule
    if fit is not None and 1 < coordinates(fit.basis.of, fit.basis.selected) <= MAX_FACTORS:
        return ValueTable(FittedKnots(*fitted_marginal(schedule, fit)))  # pyright: ignore
    kind = simulator_of(problem).interpolation
    return ValueTable.of(marginal_values(schedule, result, kind))


def case_of(setup: Setup) -> StorageCase:
    """The prepared case."""
    assert isinstance(setup.case, StorageCase)
    return setup.case


def policy_of(solution: Solution) -> StoragePolicy:
    """The trained policy."""
    assert isinstance(solution.policy, StoragePolicy)
    return solution.policy


def factors(problem: Problem) -> GaussianFactors | None:
    """The price factors that a dynamic program can use."""
    return simulator_of(problem).process.factors(of_prices(problem.schedule))


def on_independent_paths(setup: Setup) -> Problem:
    """The same problem on scenarios other than those of the value, if there are any."""
    seed = setup.training.seed
    if case_of(setup).model.sources(seed):
        return setup.problem
    return _measured_on(setup.problem, Pseudo(seed, stream=stream(EVALUATE, BESIDE)))


def _measured_on(problem: Problem, source: Pseudo) -> Problem:
    old = problem.sources
    return replace(problem, sources=Sources(old.training, old.validation, source))


def _hedge(setup: Setup) -> np.ndarray:
    """The forward volumes [T] of the control variate: the deltas of the rule of the value table."""
    problem, policy, engine = setup.problem, setup.policy, setup.engines.evaluate
    assert isinstance(policy, StoragePolicy)
    plain = replace(problem, objective=Mean(OUTPUT))
    on = _measured_on(plain, Pseudo(setup.training.seed, stream=stream(EVALUATE, HEDGE)))
    path = DerivativePass(on, engine.bind(on), policy.value_rule, Exact(), held=True)
    derivatives = path.derivatives([np.arange(HEDGE_PATHS)])  # one block: its error is not used
    simulator = simulator_of(problem)
    deltas = derivatives.inputs[simulator.curve.name].value[: simulator.horizon]
    return deltas / problem.schedule.steps.gas_discount
