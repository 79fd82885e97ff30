"""Compares the methods for a store."""

import abc
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from snapo.study.chapters import ladder
from snapo.study.chapters.ladder import CommonPaths, Estimated, MethodLadder, ValuationMethod
from snapo.study.study import StudyRun

from ..bounds.relaxation import StoreRelaxation
from ..ladder.methods import DeskMethods
from ..ladder.products import usual_products
from ..ladder.store import FlatStore
from ..references.intrinsic import intrinsic
from ..setup import case_of, factors
from .value import REFERENCE, measure_reference

NO_LATTICE = "its prices have risks other than one or two Gaussian factors"


class ReferenceValue(Protocol):
    """The exact value and its error; None if there is no exact value."""

    @property
    def dynamic_programming(self) -> float | None: ...

    @property
    def dynamic_programming_error(self) -> float | None: ...


@dataclass(frozen=True, eq=False)
class ContractMethods(abc.ABC):
    """The methods of a contract, on common paths."""

    run: StudyRun
    paths: CommonPaths

    @cached_property
    @abc.abstractmethod
    def relaxation(self) -> Any:
        """The inner problem of the bound, with `on_paths`."""

    @cached_property
    @abc.abstractmethod
    def desk(self) -> DeskMethods:
        """The methods that use the traded products."""

    @property
    def traded(self) -> DeskMethods:
        """The methods that trade the products; `ValueError` if a contract has none."""
        return self.desk

    @abc.abstractmethod
    def by_day(self) -> Estimated:
        """The intrinsic value."""

    @property
    def regressed(self) -> str:
        """The meaning of `least_squares` in a report."""
        return "regression on other paths"

    @abc.abstractmethod
    def least_squares(self) -> np.ndarray:
        """[N] the earnings of least-squares Monte Carlo on each path."""

    @abc.abstractmethod
    def reference(self) -> ReferenceValue:
        """The exact value."""

    @property
    def scale(self) -> np.ndarray:
        return np.ones(self.relaxation.terms)

    @property
    def on_paths(self) -> tuple[np.ndarray, np.ndarray]:
        """Spot prices [T or T + 1, N] and factors [T + 1, F, N]."""
        pairs = [self.relaxation.on_paths(rollout) for _, rollout in self.paths.rollouts]
        spots, states = zip(*pairs)
        return np.concatenate(spots, axis=-1), np.concatenate(states, axis=-1)

    def policy(self) -> np.ndarray:
        """[N] the earnings of the policy minus its penalties, which have mean zero."""

        def charged(draws, rollout) -> np.ndarray:
            return self.relaxation.charged(rollout, draws, self.scale)

        return self.paths.earned - self.paths.joined(charged)

    def lattice(self) -> Estimated:
        value = self.reference()
        if value.dynamic_programming is None:
            raise ValueError(NO_LATTICE)
        return Estimated(value.dynamic_programming, value.dynamic_programming_error)

    def best(self, penalty: float) -> np.ndarray:
        """[N] the earnings of perfect foresight, with the penalty (1) or without it (0)."""
        scale = penalty * self.scale
        return self.paths.joined(lambda draws, rollout: self.relaxation.best(rollout, draws, scale))

    def measured(self) -> MethodLadder:
        """All methods; the bound comes first, and the others use its penalty too."""
        methods = [
            ValuationMethod(
                ladder.UPPER, "perfect foresight, minus a penalty", lambda: self.best(1.0)
            ),
            ValuationMethod(
                ladder.FORESIGHT,
                "perfect foresight: each path is known from the start",
                lambda: self.best(0.0),
            ),
            ValuationMethod(ladder.POLICY, "the policy of this run", self.policy),
            ValuationMethod(ladder.BY_DAY, "all flows fixed today", self.by_day),
            ValuationMethod(
                ladder.IN_PRODUCTS,
                "flows fixed today, equal on all days of a product, minus the bid-offer",
                lambda: Estimated(self.traded.intrinsic()),
            ),
            ValuationMethod(
                ladder.ROLLING,
                "planned again each day in traded products, minus the bid-offer",
                lambda: self.traded.rolling(),
            ),
            ValuationMethod(ladder.LEAST_SQUARES, self.regressed, self.least_squares),
            ValuationMethod(ladder.LATTICE, "dynamic programming", self.lattice),
        ]
        return ladder.side_by_side(self.run, self.paths, methods)


class StoreMethods(ContractMethods):
    """The methods of a store."""

    @cached_property
    def relaxation(self) -> StoreRelaxation:
        return StoreRelaxation(self.run.setup.problem)

    @cached_property
    def desk(self) -> DeskMethods:
        setup, (spots, states) = self.run.setup, self.on_paths
        case, schedule = case_of(setup), setup.problem.schedule
        return DeskMethods(
            FlatStore(schedule, case.contract.ratchets.interpolation),
            case.products or usual_products(case.days, case.valuation_date),
            np.append(schedule.steps.forward, schedule.constants.end_forward),
            factors(setup.problem),
            states,
            spots,
            setup.training.seed,
        )

    def by_day(self) -> Estimated:
        setup = self.run.setup
        kind = case_of(setup).contract.ratchets.interpolation
        return Estimated(intrinsic(setup.problem.schedule, kind).value)

    def least_squares(self) -> np.ndarray:
        money, levels = self.desk.least_squares()
        return money - self.relaxation.inner.charged(levels, self.desk.states)

    def reference(self) -> ReferenceValue:
        return REFERENCE.of(self.run) or measure_reference(self.run)


def measure(run: StudyRun) -> MethodLadder:
    """Applies every method to a store."""
    return StoreMethods(run, ladder.common_paths(run)).measured()


METHODS = replace(ladder.METHODS, measure=measure)
