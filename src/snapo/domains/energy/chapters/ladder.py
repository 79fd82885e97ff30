"""Methods side by side, of a contract."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64
from snapo.study.chapters import ladder
from snapo.study.chapters.ladder import Estimated, MethodLadder
from snapo.study.study import StudyRun

from ...gas_storage.chapters.ladder import ContractMethods, ReferenceValue
from ...gas_storage.ladder.methods import DeskMethods
from ...gas_storage.ladder.products import usual_products
from ..core.contract import ContractLayout
from ..core.intraday import IntradaySimulator
from ..core.policy import UnitValuePolicy
from ..core.simulator import simulator_of
from ..methods.flat import FlatVolumes, no_flat_volumes
from ..methods.hindsight import EnergyRelaxation
from ..methods.lattice import lattice
from ..setup import case_of, factors_of
from .reference import REFERENCE
from .reference import measure as measure_reference


class EnergyMethods(ContractMethods):
    """Those of any contract of energy."""

    @cached_property
    def relaxation(self) -> EnergyRelaxation:
        return EnergyRelaxation(self.run.setup.problem)

    @property
    def layout(self) -> ContractLayout:
        return simulator_of(self.run.setup.problem).layout

    @property
    def intraday(self) -> bool:
        """Whether differences from a schedule are traded."""
        return isinstance(self.run.setup.problem.simulator, IntradaySimulator)

    @cached_property
    def desk(self) -> DeskMethods:
        setup = self.run.setup
        if self.intraday:
            raise ValueError("this method has no schedules with trades of the differences")
        case, schedule = case_of(setup), setup.problem.schedule
        contract, (spots, states) = FlatVolumes(self.layout, schedule), self.on_paths
        return DeskMethods(
            contract,
            case.products or usual_products(case.days, case.valuation_date),
            np.append(schedule.steps.forward, schedule.steps.forward[-1:]),
            factors_of(setup.problem),
            states,
            np.concatenate([spots, spots[-1:]]),
            setup.training.seed,
        )

    def by_day(self) -> Estimated:
        return Estimated(lattice(self.layout, self.run.setup.problem.schedule, None).value)

    def least_squares(self) -> np.ndarray:
        """Of a contract of several levels or modes: the fitted value, on the same paths."""
        if no_flat_volumes(self.layout) or self.intraday:
            return self._fitted_rule()
        money, levels = self.desk.least_squares()
        levels = levels[:, :, None][:, :, : len(self.layout.levels)]
        mode, first = np.zeros(levels.shape[:2], int), 0
        for _, rollout in self.paths.rollouts:
            some = slice(first, first + len(rollout.state.levels))
            money[some] -= self.relaxation.charged_along(
                rollout, levels[:, some], mode[:, some], self.scale
            )
            first = some.stop
        return money

    def _fitted_rule(self) -> np.ndarray:
        setup, policy = self.run.setup, self.run.solution.policy
        assert isinstance(policy, UnitValuePolicy)
        engine = setup.engines.evaluate.bind(setup.problem)

        def earned(draws, rollout) -> np.ndarray:
            other = engine.values(policy.value_rule, draws, Exact(), record=TRAJECTORY)
            money = setup.problem.objective.influence(float64(other.totals))
            return money - self.relaxation.charged(other, draws, self.scale)

        return self.paths.joined(earned)

    def lattice(self) -> Estimated:
        if self.intraday:
            raise ValueError("a schedule and the levels are too many for a lattice")
        return super().lattice()

    def reference(self) -> ReferenceValue:
        return REFERENCE.of(self.run) or measure_reference(self.run)


def measure(run: StudyRun) -> MethodLadder:
    """Every method of a contract."""
    return EnergyMethods(run, ladder.common_paths(run)).measured()


METHODS = replace(ladder.METHODS, measure=measure)
