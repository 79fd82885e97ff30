"""The bound of a storage problem: its store of known prices, behind the core's `Relaxation`."""

import jax
import numpy as np

from snapo.problem.problem import Problem

from ..contract.schedule import of_prices
from ..contract.simulator import simulator_of
from .hindsight import INVENTORIES, Hindsight, PenaltyScale
from .value_iteration import fit_value

PARTS = 3  # of the penalty: polynomials, hinges, the constant


class StoreRelaxation:
    """See `snapo.Relaxation`.

    `fitted_value` is the value function of the penalty, where the price process has Gaussian
    factors; it is a finer one than that of the policy's guide.
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
        return "the surprises of a fitted value of the store"

    def best(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        states = self._path(rollout, "price")
        return self.inner.best(self._spots(states), self._factors(states), self._scales(scale))

    def charged(self, rollout, draws, scale: np.ndarray) -> np.ndarray:
        states, inventory = self._path(rollout, "price"), self._path(rollout, "inventory")
        return self.inner.charged(inventory, self._factors(states), self._scales(scale))

    def _path(self, rollout, name: str):
        """A part of the state on the T days and on the end date, leaves [T + 1, N, …]."""
        days, end = getattr(rollout.record["state"], name), getattr(rollout.state, name)
        return jax.tree.map(lambda a, b: np.concatenate([a, np.asarray(b)[None]]), days, end)

    def _spots(self, states) -> np.ndarray:
        """[T + 1, N] spot prices; NaN-free also where the end date needs none."""
        with jax.enable_x64(True):
            level = jax.vmap(self.process.level, in_axes=(None, None, 0))
            daily = jax.vmap(level, in_axes=(None, 0, 0))
            return np.asarray(daily(self.prices.constants, self.prices.steps, states))

    def _factors(self, states) -> np.ndarray:
        """[T + 1, F, N] the price factors of the penalty."""
        with jax.enable_x64(True):
            result = jax.vmap(jax.vmap(self.process.gaussian))(states)
        return np.ascontiguousarray(np.moveaxis(np.asarray(result), 1, 2))

    def _scales(self, scale: np.ndarray) -> PenaltyScale:
        """The scale of each function of the basis, from those of the penalty's parts."""
        if self.fitted_value is None or not len(scale):
            return 1.0
        basis = self.fitted_value.basis
        counts = [len(basis.powers), len(basis.hinges), bool(basis.common)]
        return np.repeat(scale, counts)
