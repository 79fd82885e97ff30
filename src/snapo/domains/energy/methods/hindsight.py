"""The upper bound: the best moves on each path with perfect foresight, minus a penalty.

The penalty for ending a step in a mode and at certain levels is the innovation of the fitted value
there, V(next prices) - E[V(next prices)], which has mean zero for decisions without foresight. The
bound is valid for any V; see `snapo.solver.bound`. V is linear between nodes. If all volumes of
best decisions lead from node to node (`ContractGrid.exact`), the best penalised moves do so too.
"""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from snapo.problem.problem import Problem

from ...gas_storage.bounds.regression import product
from ..core.contract import StepPrices
from ..core.intraday import GAIN
from ..core.simulator import simulator_of
from ..setup import fitted_value, price_schedule
from .corners import corners
from .grid import arrived, best, grid_of

BLOCK = 128  # paths at once
PARTS = 3  # of the penalty: polynomials, hinges, the constant


class EnergyRelaxation:
    """See `snapo.Relaxation`."""

    description = "the innovations of a fitted value of the contract"

    def __init__(self, problem: Problem):
        simulator = simulator_of(problem)
        self.layout = simulator.layout
        self.process, self.schedule = simulator.process, problem.schedule
        self.prices, result = price_schedule(problem), fitted_value(problem)
        self.fitted = None if result is None else result.fitted
        self.factors = None if result is None else result.factors
        self.grid = grid_of(self.layout, self.schedule) if result is None else result.fitted.grid
        if not self.grid.exact:
            raise ValueError("its volumes have no common divisor with few enough nodes for a bound")

    @property
    def terms(self) -> int:
        return 0 if self.fitted is None else PARTS

    def best(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        prices = self._path(rollout.record["state"].price, rollout.state.price)
        spots, innovations = self._spots(prices), self._innovations(prices, scale)
        index = self._index(prices)
        blocks = [slice(i, i + BLOCK) for i in range(0, spots.shape[1], BLOCK)]

        def solve(block: slice) -> np.ndarray:
            moved = None if innovations is None else innovations[:, :, block]
            local = None if index is None else index[:, block]
            return self._solve(spots[:, block], local, moved)

        with ThreadPoolExecutor(2) as pool:
            return np.concatenate(list(pool.map(solve, blocks)))

    def charged(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        record, end = rollout.record["state"], rollout.state
        levels = self._path(record.levels, end.levels)
        mode = np.argmax(self._path(record.mode, end.mode), axis=2)
        charge = self.charged_along(rollout, levels, mode, scale)
        # The gain of a schedule has mean zero, and no part in the inner problem.
        return charge + np.asarray(rollout.totals.get(GAIN, 0.0), float)

    def charged_along(self, rollout, levels, mode, scale: np.ndarray) -> np.ndarray:
        """[N] penalties on the prices of a rollout, for other levels [T + 1, N, levels] and modes
        [T + 1, N]."""
        prices = self._path(rollout.record["state"].price, rollout.state.price)
        innovations, total = self._innovations(prices, scale), np.zeros(levels.shape[1])
        if innovations is None or self.fitted is None:
            return total
        for nodes, table, moved, level, now in zip(
            self.grid.nodes, self.fitted.coefficients, innovations, levels, mode
        ):
            rows, weights = corners(nodes, level, self.layout.signs)
            for row, weight in zip(rows, weights):
                total += weight * np.einsum("pk,kp->p", table[now, row], moved)
        return total

    def on_paths(self, rollout) -> tuple[np.ndarray, np.ndarray]:
        """[T, N] spot prices of a rollout, and [T + 1, F, N] its price factors."""
        states = self._path(rollout.record["state"].price, rollout.state.price)
        return self._spots(states), self._factors(states)

    def _solve(
        self, spots: np.ndarray, index: np.ndarray | None, innovations: np.ndarray | None
    ) -> np.ndarray:
        terms, horizon = self.schedule.steps.terms, len(self.grid.steps)
        count = len(self.layout.modes)
        value = np.zeros((count, self.grid.size(horizon), spots.shape[1]))
        for t in reversed(range(horizon + 1)):
            if t < horizon:
                prices = StepPrices(spots[t], None if index is None else index[t])
                cash, fixed = prices.units(terms, t), prices.moves(terms, t)
                after = arrived(self.grid.steps[t], value)
                value = best(self.grid.steps[t], self.layout, cash, fixed, after)
            if innovations is not None and self.fitted is not None:
                table = self.fitted.coefficients[t]
                value = value - product(table.reshape(-1, table.shape[2]), innovations[t]).reshape(
                    value.shape
                )
        return value[0, 0]

    def _path(self, days, end):
        """A part of the state at the T steps and after them, leaves [T + 1, N, …]."""
        return jax.tree.map(lambda a, b: np.concatenate([a, np.asarray(b)[None]]), days, end)

    def _spots(self, states) -> np.ndarray:
        """[T, N] the spot prices."""
        count = len(self.grid.steps)
        rows = jax.tree.map(lambda leaf: leaf[:count], (self.prices.steps, states))
        with jax.enable_x64(True):
            level = jax.vmap(self.process.level, in_axes=(None, None, 0))
            spots = jax.vmap(level, in_axes=(None, 0, 0))(self.prices.constants, *rows)
        return np.asarray(spots)

    def _index(self, states) -> np.ndarray | None:
        """[T, N] the index, if there is one."""
        if self.factors is None or self.factors.index is None:
            return None
        of, factors = self.factors, self._factors(states)
        return np.stack([of.index.at(of, t, factors[t]) for t in range(len(self.grid.steps))])

    def _innovations(self, states, scale: np.ndarray) -> np.ndarray | None:
        """[T + 1, K, N] functions of the prices minus their expectation a step before."""
        if self.fitted is None:
            return None
        basis = self.fitted.basis
        moved = basis.increments(self._factors(states))
        return moved * scale[basis.parts][:, None]

    def _factors(self, states) -> np.ndarray:
        """[T + 1, F, N] the price factors."""
        with jax.enable_x64(True):
            result = jax.vmap(jax.vmap(self.process.gaussian))(states)
        return np.ascontiguousarray(np.moveaxis(np.asarray(result), 1, 2))
