"""The bound of a storage problem: a store on known prices, penalised for perfect foresight.

    penalty of ending day t with inventory I = V(I, X(t + 1)) - E[V(I, X(t + 1)) | X(t)]

With any V of the next day, the penalty has mean zero for a rule without foresight. The mean of the
best penalised earnings is therefore at least the value of every such rule. With the exact V the
best penalised earnings are the exact value on every path. Sources: see `snapo.solver.bound`.
"""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from snapo.problem.problem import Problem

from ..contract.schedule import of_prices
from ..contract.simulator import simulator_of
from ..prices.process import PriceProcess
from ..references.day_terms import Interpolation, end_value, unit_prices
from .day_grid import DayGrid, best_value, day_grids
from .regression import product
from .value_iteration import FittedValue, fit_value

PenaltyScale = float | np.ndarray
BLOCK = 128  # paths at once: their arrays stay in the cache
INVENTORIES = 141


class Hindsight:
    """The penalised store of a schedule (NumPy leaves).

    - `fitted_value`: the function V of the penalty, None for perfect foresight without a penalty.
    - `inventories`: the number of grid points from 0 to the largest inventory. Between them the
      value is bounded from above (`best_value`), so that a coarse grid only makes the bound higher.
    """

    def __init__(
        self,
        schedule,
        interpolation: Interpolation,
        fitted_value: FittedValue | None,
        inventories: int = INVENTORIES,
    ):
        self.schedule, self.fitted_value = schedule, fitted_value
        self.days = day_grids(schedule, interpolation, inventories)
        grids = [day.nodes for day in self.days] + [self.days[-1].after]
        self.grids = grids
        self.coefficients = None
        if fitted_value is not None:
            self.coefficients = [fitted_value.at(t, nodes) for t, nodes in enumerate(grids)]

    def best(self, spots: np.ndarray, states: np.ndarray, scale: PenaltyScale = 1.0) -> np.ndarray:
        """[paths] the maximum penalised earnings of each path. `spots` [T + 1, paths]: spot
        prices; `states` [T + 1, F, paths]: price factors; `scale`: the scale of the penalty, one
        number or a number for each function of the basis.
        """
        blocks = [slice(i, i + BLOCK) for i in range(0, spots.shape[1], BLOCK)]

        def solve(block: slice) -> np.ndarray:
            return self._solve(spots[:, block], self._surprises(states[:, :, block], scale))

        with ThreadPoolExecutor(2) as pool:
            return np.concatenate(list(pool.map(solve, blocks)))

    def charged(
        self, inventory: np.ndarray, states: np.ndarray, scale: PenaltyScale = 1.0
    ) -> np.ndarray:
        """[paths] the penalties along these inventories [T + 1, paths].

        The mean is zero only if each inventory was decided without foresight.
        """
        if states.shape[2] > BLOCK:
            blocks = [slice(i, i + BLOCK) for i in range(0, states.shape[2], BLOCK)]
            charged = [self.charged(inventory[:, x], states[:, :, x], scale) for x in blocks]
            return np.concatenate(charged)
        innovations = self._surprises(states, scale)
        if innovations is None or self.coefficients is None:
            return np.zeros(inventory.shape[1])
        total = np.zeros(inventory.shape[1])
        for nodes, table, moved, stock in zip(
            self.grids, self.coefficients, innovations, inventory, strict=True
        ):
            position = np.interp(stock, nodes, np.arange(len(nodes), dtype=float))
            left = np.clip(position.astype(int), 0, max(len(nodes) - 2, 0))
            share = (position - left)[:, None]
            right = np.minimum(left + 1, len(nodes) - 1)
            result = table[left] * (1 - share) + table[right] * share
            total += np.einsum("pk,kp->p", result, moved)
        return total

    def _surprises(self, states: np.ndarray, scale: PenaltyScale) -> np.ndarray | None:
        """[T + 1, K, paths] functions of the prices minus their expectation a day before."""
        if self.fitted_value is None:
            return None
        moved = self.fitted_value.basis.increments(states)
        return moved * np.broadcast_to(scale, moved.shape[1])[:, None]

    def _solve(self, spots: np.ndarray, innovations: np.ndarray | None) -> np.ndarray:
        schedule, horizon = self.schedule, len(self.days)
        value = end_value(schedule, self.days[-1].after[:, None], spots[horizon])
        for t in reversed(range(horizon)):
            day: DayGrid = self.days[t]
            if innovations is not None and self.coefficients is not None:
                value -= product(self.coefficients[t + 1], innovations[t + 1])
            prices = unit_prices(schedule, t, spots[t])
            value = best_value(day, prices, value, above=True)
        if innovations is not None and self.coefficients is not None:
            value -= self.coefficients[0] @ innovations[0]
        return value[0]


PARTS = 3  # of the penalty: polynomials, hinges, the constant


class StoreRelaxation:
    """See `snapo.Relaxation`.

    `fitted_value` is the value function of the penalty, if the price process has Gaussian factors;
    its grid is finer than that of the value table of the policy.
    """

    def __init__(self, problem: Problem, inventories: int = INVENTORIES):
        simulator = simulator_of(problem)
        self.process, schedule = simulator.process, problem.schedule
        self.prices = of_prices(schedule)
        kind = simulator.interpolation
        factors = self.process.factors(self.prices)
        self.fitted_value = None if factors is None else fit_value(schedule, factors, kind)
        self.inner = Hindsight(schedule, kind, self.fitted_value, inventories)

    @property
    def terms(self) -> int:
        return 0 if self.fitted_value is None else PARTS

    @property
    def description(self) -> str:
        return "the innovations of a fitted value of the store"

    def best(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        return self.inner.best(*self.on_paths(rollout), self._scales(scale))

    def charged(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        states = factors_on_paths(self.process, rollout)
        return self.inner.charged(path_of(rollout, "inventory"), states, self._scales(scale))

    def on_paths(self, rollout) -> tuple[np.ndarray, np.ndarray]:
        """[T + 1, N] spot prices of a rollout, and [T + 1, F, N] its price factors."""
        spots = spots_on_paths(self.process, self.prices, rollout)
        return spots, factors_on_paths(self.process, rollout)

    def _scales(self, scale: np.ndarray) -> PenaltyScale:
        """The scale of each function of the basis, from the scales of the parts of the penalty."""
        if self.fitted_value is None or not len(scale):
            return 1.0
        return scale[self.fitted_value.basis.parts]


def path_of(rollout, name: str):
    """A part of the state on the T days and on the end date, leaves [T + 1, N, …]."""
    days, end = getattr(rollout.record["state"], name), getattr(rollout.state, name)
    return jax.tree.map(lambda a, b: np.concatenate([a, np.asarray(b)[None]]), days, end)


def spots_on_paths(process: PriceProcess, prices, rollout) -> np.ndarray:
    """[T + 1, N] spot prices of a rollout, without NaN even if no price is needed on the end date.

    `prices`: the prepared schedule of the process.
    """
    with jax.enable_x64(True):
        level = jax.vmap(process.level, in_axes=(None, None, 0))
        daily = jax.vmap(level, in_axes=(None, 0, 0))
        return np.asarray(daily(prices.constants, prices.steps, path_of(rollout, "price")))


def factors_on_paths(process: PriceProcess, rollout) -> np.ndarray:
    """[T + 1, F, N] the price factors of a rollout."""
    with jax.enable_x64(True):
        result = jax.vmap(jax.vmap(process.gaussian))(path_of(rollout, "price"))
    return np.ascontiguousarray(np.moveaxis(np.asarray(result), 1, 2))
