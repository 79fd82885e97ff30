"""A store on simulated paths of its model, operated by a policy that sees all price factors."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.engine import BoundEngine
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64

from ..bounds.relaxation import factors_on_paths, path_of, spots_on_paths
from ..contract.schedule import of_prices
from ..contract.simulator import simulator_of
from ..ladder.methods import NO_CURVE
from ..policy.network import StoragePolicy
from ..prices.process import GaussianFactors
from ..setup import OUTPUT, factors
from .exposures import BLOCK, StorePaths


class NoForwardCurve(ValueError):
    """Paths of the model have no forward curve; the message has the reason."""


class DrawnStore(NamedTuple):
    """`paths`: the store on paths; `groups` [N]: the groups of their scenarios; `cash` [T, N]: the
    discounted cash of each day; `control` [N]: the control variate of the money, with mean zero."""

    paths: StorePaths
    groups: np.ndarray
    cash: np.ndarray
    control: np.ndarray


@dataclass(frozen=True, eq=False)
class StoreDraws:
    """A problem of a store, bound to an engine, with its policy and the seed of its paths."""

    problem: Problem
    engine: BoundEngine
    policy: StoragePolicy
    seed: int

    def __call__(self, number: int, count: int) -> DrawnStore:
        """`count` fresh paths of the stream `number` of the evaluation.

        **Raises:** `NoForwardCurve`.
        """
        problem, prices = self.problem, curve_factors(self.problem)
        simulator, schedule = simulator_of(problem), problem.schedule
        forward = np.append(schedule.steps.forward, schedule.constants.end_forward)
        discount = np.append(schedule.steps.gas_discount, schedule.constants.end_discount)
        source = Pseudo(self.seed, stream=stream(EVALUATE, number))
        controls = simulator.control_variates()
        blocks = list(source.blocks(count, max(1, -(-count // BLOCK))))
        parts = []
        for block in blocks:
            draws = source.draws(block, simulator)
            rollout = self.engine.values(self.policy, draws, Exact(), record=("state", "outputs"))
            levels = np.asarray(path_of(rollout, "inventory"), np.float64)
            sold, totals = _sold(problem, rollout, levels), float64(rollout.totals)
            money = np.asarray(totals[OUTPUT])
            part = factors_on_paths(simulator.process, rollout), levels, sold, money
            if not parts:  # whether the factors make the spot prices
                curves = StorePaths(prices, forward, discount, *part).curves
                spots = spots_on_paths(simulator.process, of_prices(schedule), rollout)
                if not np.allclose(curves.spots[:-1], spots[:-1], rtol=1e-5, atol=1e-5):
                    raise NoForwardCurve(NO_CURVE)
            cash = np.asarray(rollout.record["outputs"][OUTPUT], np.float64)
            control = sum((np.asarray(totals[name]) for name in controls), np.zeros_like(money))
            parts.append((*part, cash, control))
        joined = [np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)]
        groups = source.groups(np.concatenate(blocks))
        return DrawnStore(StorePaths(prices, forward, discount, *joined[:4]), groups, *joined[4:])


def curve_factors(problem: Problem) -> GaussianFactors:
    """The factors of the forward curve of a problem.

    **Raises:** `NoForwardCurve`.
    """
    prices = factors(problem)
    if prices is None or not prices.exact or prices.spikes is not None:
        raise NoForwardCurve(NO_CURVE)
    return prices


def _sold(problem: Problem, rollout, levels: np.ndarray) -> np.ndarray:
    """[T + 1, N] the volume sold at the price of each day, and of the end date."""
    steps, constants = problem.schedule.steps, problem.schedule.constants
    outputs = rollout.record["outputs"]
    out = (1 - steps.withdrawal_fuel)[:, None] * np.asarray(outputs["withdrawal"], np.float64)
    into = (1 + steps.injection_fuel)[:, None] * np.asarray(outputs["injection"], np.float64)
    return np.concatenate([out - into, constants.end_fraction * levels[-1:]])
