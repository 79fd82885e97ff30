"""Compares the methods for contracts with one level and either one flow or two opposite flows.

For rolling intrinsic and least-squares Monte Carlo such a contract, with flat volumes over
products, takes the form of a `gas_storage.ladder.rolling.FlatContract`.
"""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64
from snapo.study.chapters import ladder
from snapo.study.chapters.ladder import Estimated, MethodLadder
from snapo.study.study import StudyRun

from ...gas_storage.chapters.ladder import ContractMethods, ReferenceValue
from ...gas_storage.ladder.flat import Side
from ...gas_storage.ladder.methods import DeskMethods
from ...gas_storage.ladder.products import usual_products
from ..core.contract import ContractLayout
from ..core.intraday import IntradaySimulator
from ..core.policy import UnitValuePolicy
from ..core.simulator import simulator_of
from ..methods.hindsight import EnergyRelaxation
from ..methods.intrinsic import intrinsic_value
from ..methods.measure import common_measure, measures_of
from ..read.case import KINDS
from ..setup import case_of, factors_of
from .reference import REFERENCE
from .reference import measure as measure_reference


def no_flat_volumes(layout: ContractLayout) -> str:
    """The reason why a contract cannot have flat volumes over products; "" if it can."""
    if layout.indexed:
        return "this method is for contracts whose price does not follow an index"
    opposite = len(layout.flows) == 2 and len(layout.levels) == 1 and not layout.effects.sum()
    if layout.moves or not (len(layout.flows) == 1 or opposite) or len(layout.levels) > 1:
        return (
            "this method is for contracts with at most one level, with one flow or two opposite "
            "flows, and without a choice of moves"
        )
    return ""


class FlatVolumes:
    """A `FlatContract` made from a schedule with NumPy leaves.

    A volume above zero belongs to the flow that raises the level, or to the only flow; a volume
    below zero to the other flow.
    """

    every = False  # the value is concave in the level

    def __init__(self, layout: ContractLayout, schedule: Any):
        if reason := no_flat_volumes(layout):
            raise ValueError(reason)
        terms, intervals = schedule.steps.terms, schedule.steps.intervals
        self.terms, self.horizon = terms, len(terms.most)
        effects = layout.effects[:, 0] if layout.levels else np.ones(1)
        self._up = int(np.argmax(effects))
        self._down = 1 - self._up if len(effects) == 2 else None
        self._effect = float(effects[self._up])
        self._least, self._most = self._volumes()
        zero = np.zeros(self.horizon)
        self._restarts = zero.astype(bool)
        if layout.levels:
            start = np.asarray(schedule.constants.start, float)
            self.start, self.measure = float(start[0]), measures_of(layout, terms, start)[0]
            self._restarts = np.asarray(terms.restarts)[:, 0]
            low, high = intervals.next_low[:, 0], intervals.next_high[:, 0]
        else:
            self.start = 0.0
            self.measure = common_measure([*np.unique(self._most), *np.unique(self._least)])
            low, high = zero, np.cumsum(self._most)
        self._low, self._high = np.array(low, float), np.array(high, float)
        self._limit_levels(self._least * self._effect, self._most * self._effect)

    def _volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """[T] the smallest and the largest volume of each step, with their signs."""
        forced, free = np.asarray(self.terms.least), np.asarray(self.terms.most)
        if self._down is None:
            return forced[:, self._up], free[:, self._up]
        up, down = forced[:, self._up], forced[:, self._down]
        lowest = np.where(up > 0, up, -free[:, self._down])
        return lowest, np.where(down > 0, -down, free[:, self._up])

    def _limit_levels(self, least: np.ndarray, most: np.ndarray) -> None:
        """Narrows the levels after each step to those that can be reached."""
        bottom = top = self.start
        for t in range(self.horizon):
            bottom, top = bottom + min(least[t], most[t]), top + max(least[t], most[t])
            self._low[t] = bottom = max(self._low[t], bottom)
            self._high[t] = top = max(min(self._high[t], top), bottom)
            bottom, top = (0.0, 0.0) if self._restarts[t] else (bottom, top)

    def levels(self, t: int) -> tuple[float, float]:
        if t == 0:
            return self.start, self.start
        return (0.0, 0.0) if self._restarts[t - 1] else self.reached(t - 1)

    def reached(self, t: int) -> tuple[float, float]:
        return float(self._low[t]), float(self._high[t])

    def limits(self, first, after, levels, low, high):
        days = slice(first, after)
        span = self._effect * np.arange(1, after - first + 1)[:, None]
        lows, highs = self._low[days, None].copy(), self._high[days, None].copy()
        lows[-1], highs[-1] = max(low, lows[-1, 0]), min(high, highs[-1, 0])
        bounds = np.stack([(lows - levels) / span, (highs - levels) / span])
        least, most = bounds.min(axis=0).max(axis=0), bounds.max(axis=0).min(axis=0)
        forced, free = self._least[days].max(), self._most[days].min()
        return np.maximum(least, forced), np.minimum(most, free)

    def growth(self, first: int, after: int) -> tuple[float, float]:
        return 1.0, self._effect * (after - first)

    def sides(self, first: int, after: int) -> tuple[Side, Side]:
        into = self._side(first, after, self._up, -1.0)
        if self._down is None:
            return into, Side(0.0 * into.weight, 0.0, 0.0)
        return into, self._side(first, after, self._down, 1.0)

    def _side(self, first: int, after: int, flow: int, sign: float) -> Side:
        price = np.asarray(self.terms.price)[first:after, flow]
        money = float(np.sum(self.terms.money[first:after, flow]))
        return Side(sign * price, sign * float(np.sign(price).mean()), -money)

    def level_cost(self, first: int, after: int, levels: np.ndarray) -> np.ndarray:
        return self._cost(first, after, levels, at_end=False)

    def end_cost(self, first: int, after: int, levels: np.ndarray) -> np.ndarray | None:
        if self.terms.of_levels is None:
            return None
        return self._cost(first, after, levels, at_end=True)

    def _cost(self, first: int, after: int, levels: np.ndarray, at_end: bool) -> np.ndarray:
        """The money of the levels within a period, as a function of the levels at its start or at
        its end.

        The size of the level on a day is taken as a weighted mean of its sizes at the start and the
        end. This is exact unless the level passes zero in the period: its size is then smaller than
        the mean.
        """
        if self.terms.of_levels is None:
            return np.zeros_like(levels)
        days = np.arange(after - first + 1) / (after - first)
        share = days if at_end else 1.0 - days
        before, after_moves = (np.asarray(x)[first:after, 0] for x in self.terms.of_levels)
        below, above = share[:-1] @ before - share[1:] @ after_moves
        return below * np.maximum(-levels, 0.0) + above * np.maximum(levels, 0.0)

    def discount(self, first: int, after: int) -> np.ndarray:
        return np.abs(np.asarray(self.terms.price)[first:after, 0])

    def settled(self, t: int, levels: np.ndarray) -> np.ndarray | None:
        if not self._restarts[t]:
            return None
        missed = np.maximum(self.terms.owed[t, 0] - levels, 0.0)
        return self.terms.short[t, 0] * missed

    def final(self, levels: np.ndarray, price: np.ndarray) -> np.ndarray:
        return np.zeros_like(levels + 0.0 * price)


class EnergyMethods(ContractMethods):
    """The methods of any energy contract."""

    @cached_property
    def relaxation(self) -> EnergyRelaxation:
        return EnergyRelaxation(self.run.setup.problem)

    @property
    def layout(self) -> ContractLayout:
        return simulator_of(self.run.setup.problem).layout

    @property
    def intraday(self) -> bool:
        """Whether the contract trades differences from a schedule."""
        return isinstance(self.run.setup.problem.simulator, IntradaySimulator)

    @cached_property
    def desk(self) -> DeskMethods:
        setup = self.run.setup
        if self.intraday:
            raise ValueError("this method cannot trade differences from a schedule")
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

    @property
    def traded(self) -> DeskMethods:
        if KINDS[case_of(self.run.setup).kind].hourly:
            raise ValueError("products last a day or longer, but the steps are hours")
        return self.desk

    def by_day(self) -> Estimated:
        return Estimated(intrinsic_value(self.layout, self.run.setup.problem.schedule))

    @property
    def of_value(self) -> bool:
        """Whether the row of least squares shows the fitted value, as for several levels or
        modes."""
        return bool(no_flat_volumes(self.layout)) or self.intraday

    @property
    def regressed(self) -> str:
        if not self.of_value:
            return super().regressed
        policy, rule = self.run.solution.policy, "the fitted value, from which training began"
        assert isinstance(policy, UnitValuePolicy)
        same = policy.simplest.network is None
        return f"{rule}: the policy of this run is the same" if same else rule

    def least_squares(self) -> np.ndarray:
        """Earnings on each path; for a contract with several levels or modes, those of the fitted
        value."""
        if self.of_value:
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
            raise ValueError("a lattice cannot have a schedule in addition to the levels")
        return super().lattice()

    def reference(self) -> ReferenceValue:
        return REFERENCE.of(self.run) or measure_reference(self.run)


def measure(run: StudyRun) -> MethodLadder:
    """Applies every method to a contract."""
    return EnergyMethods(run, ladder.common_paths(run)).measured()


METHODS = replace(ladder.METHODS, measure=measure)
