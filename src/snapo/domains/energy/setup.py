"""Prepares a case for the solver: the problem with its fitted value, its policy and its engines."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.case.objective import make_objective
from snapo.engine import EngineName
from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.simulator import Schedule
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.solve import Evaluation
from snapo.study.ready import engines_for
from snapo.study.study import Setup

from ..gas_storage.bounds.regression import AnyBasis, basis_of
from ..gas_storage.prices.process import GaussianFactors, PriceProcess
from .core.intraday import IntradayPolicy, IntradaySimulator, simulator_kind, without_trades
from .core.policy import UnitValuePolicy
from .core.simulator import simulator_of
from .core.tables import UnitValueTable
from .methods.fitted import FittedContract, fit
from .methods.grid import ContractGrid, grid_of
from .methods.value_tables import value_tables
from .read.case import EnergyCase

OUTPUT = "cash_flow"
MAX_FACTORS = 3  # of a fitted value, next to those that move all prices in proportion


def bare_problem(case: EnergyCase) -> Problem:
    """The contract without a fitted value."""
    return Problem(
        simulator_kind(case).of(case), case.inputs(), make_objective(case.objective, OUTPUT)
    )


def make_setup(case: EnergyCase, engine: EngineName = "auto") -> Setup:
    """The simulator with its fitted value, the scenarios, the policy and the engines."""
    evaluation, seed = Evaluation(**case.evaluation.model_dump()), case.training.seed
    sources = case.model.sources(seed) or evaluation.sources(seed)
    problem = fitted_problem(replace(bare_problem(case), sources=sources, rebuild=rebuilt))
    fitted = simulator_of(problem).surprises is not None and case.objective.kind == "mean"
    training = TrainingPlan.from_settings(case.training.model_dump(), fitted)
    rule = UnitValuePolicy if case.scheduled is None else IntradayPolicy
    # Training begins with the fitted value: where margins are low, random corrections would lose.
    layout, key = simulator_of(problem).layout, jax.random.key(seed)
    policy = rule(layout, problem.features, key=key).value_rule
    return Setup(
        problem, policy, training, evaluation, engines_for(engine, problem, policy), case=case
    )


def setup_at(setup: Setup, case: EnergyCase) -> Setup:
    """The setup of a case that differs from that of `setup` only in its numbers; it equals
    `make_setup(case)`."""
    bare = bare_problem(case)
    if case.model.sources(setup.training.seed) or bare.form != _bare(setup.problem).form:
        return make_setup(case, setup.engines.name)  # pyright: ignore[reportArgumentType]
    moved = replace(setup.problem, simulator=bare.simulator, inputs=bare.inputs)
    return setup._replace(problem=rebuilt(moved), case=case)


def rebuilt(problem: Problem) -> Problem:
    """The problem with the fitted value and the scales of features of its inputs.

    The nodes of the fitted value have the same distances as before, and the policy reads them in
    the same way, so that values are equally accurate.
    """
    table = simulator_of(problem).unit_values
    problem = _bare(problem)
    values = {name: item.value for name, item in problem.inputs_by_name.items()}
    problem = replace(problem, simulator=simulator_of(problem).scaled(values))
    return fitted_problem(problem, table)


def _bare(problem: Problem) -> Problem:
    simulator = replace(simulator_of(problem), unit_values=None, surprises=None)
    if isinstance(simulator, IntradaySimulator):
        simulator = replace(simulator, scheduled_values=None)
    return replace(problem, simulator=simulator)


def fitted_problem(problem: Problem, before: UnitValueTable | None = None) -> Problem:
    """The problem with the unit values from which its policy starts, and with a control variate if
    prices have no risks other than the factors of the fit. `before`: the unit values at other
    inputs, if they were fitted before; the new ones are read in the same way."""
    simulator, layout = simulator_of(problem), simulator_of(problem).layout
    apart, like = np.zeros(len(layout.levels)), None
    if before is not None:
        apart, like = before.steps.rows.spacing.max(axis=0), before.steps
    values = _value_functions(problem, apart)
    if values is None:
        return problem
    if isinstance(simulator, IntradaySimulator):
        other = without_trades(problem, scheduled=True)
        scheduled = _value_functions(other, apart)
        assert scheduled is not None  # its prices have the same factors
        table = value_tables(layout, other.schedule, *scheduled, like).unit_values
        simulator = replace(simulator, scheduled_values=table)
    tables = value_tables(layout, problem.schedule, *values, like)
    simulator = replace(simulator, **tables._asdict())
    return replace(problem, simulator=simulator)


class FactorFit(NamedTuple):
    """A fitted value and the price factors on which it depends."""

    fitted: FittedContract
    factors: GaussianFactors


def fitted_value(problem: Problem) -> FactorFit | None:
    """The fitted value, if prices have at most three Gaussian factors that matter."""
    values = _value_functions(problem)
    if values is None:
        return None
    factors, _, grid = values
    return FactorFit(fit(simulator_of(problem).layout, problem.schedule, factors, grid), factors)


def _value_functions(
    problem: Problem, apart: np.ndarray | None = None
) -> tuple[GaussianFactors, AnyBasis, ContractGrid] | None:
    """The price factors, the functions of them, and the nodes of the levels of a fitted value; None
    if prices have too many factors. `apart`: for a coarse grid, see `grid_of`."""
    factors = factors_of(problem)
    if factors is None:
        return None
    basis = basis_of(factors, priced=False)
    if len(basis.selected) > MAX_FACTORS:
        return None
    return factors, basis, grid_of(simulator_of(problem).layout, problem.schedule, apart=apart)


def price_schedule(problem: Problem) -> Schedule:
    """The schedule of the price process, with T + 1 rows in NumPy."""
    with jax.enable_x64(True):
        inputs = {name: np.asarray(x.value) for name, x in problem.inputs_by_name.items()}
        return jax.tree.map(np.asarray, _prepare(simulator_of(problem).process, inputs))


@compiled_sooner
def _prepare(process: PriceProcess, inputs: dict[str, Any]) -> Schedule:
    return process.prepare(inputs)


def factors_of(problem: Problem) -> GaussianFactors | None:
    """The price factors that a dynamic program can use."""
    return simulator_of(problem).process.factors(price_schedule(problem))


def case_of(setup: Setup) -> EnergyCase:
    """The prepared case."""
    assert isinstance(setup.case, EnergyCase)
    return setup.case
