"""The store of known prices, each of its decisions charged what was learnt from hindsight.

    penalty of ending day t with inventory I = V(I, X(t + 1)) - E[V(I, X(t + 1)) | X(t)]

For any V of the day after, the penalty has mean zero for whoever decides without foresight, so the
mean of the best penalised earnings lies above the value of every such rule; with the exact V it is
the exact value, on every path. Sources: see `snapo.solver.bound`.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..references.day_terms import Interpolation, end_value, unit_prices
from .best_flow import best_value
from .day_grid import DayGrid, day_grids
from .product import product
from .value_iteration import FittedValue

PenaltyScale = float | np.ndarray
BLOCK = 128  # paths at once: their arrays stay in the cache
INVENTORIES = 141


class Hindsight:
    """The penalised store of a schedule (NumPy leaves).

    - `fitted_value`: the V of the penalty, None for none (perfect foresight).
    - `inventories`: points of the grid from 0 to the largest inventory. Between them the value
      is held from above (`best_value`): a coarse grid gives a higher bound and never a low one.
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
        """[paths] the most that each path can earn, penalised.

        `spots` [T + 1, paths], `states` [T + 1, F, paths] of the price factors; `scale`: of the
        penalty, a number or one for each function of the basis.
        """
        blocks = [slice(i, i + BLOCK) for i in range(0, spots.shape[1], BLOCK)]

        def solve(block: slice) -> np.ndarray:
            return self._solve(spots[:, block], self._surprises(states[:, :, block], scale))

        with ThreadPoolExecutor(2) as pool:
            return np.concatenate(list(pool.map(solve, blocks)))

    def charged(
        self, inventory: np.ndarray, states: np.ndarray, scale: PenaltyScale = 1.0
    ) -> np.ndarray:
        """[paths] the penalties on the way of these inventories [T + 1, paths]: of mean zero.

        Where each inventory was decided without foresight.
        """
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
        """[T + 1, K, paths] functions of the prices less their expectation a day before."""
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
