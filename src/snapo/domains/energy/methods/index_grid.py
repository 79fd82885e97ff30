"""Nodes of a spot price's factor f and of its month-ahead index's factor g, for the lattice.

Within a month g stays: a step is the transition of f at each node of g. Into a month g becomes f of
the day before, so that the value there is read at g = f, by a cubic spline between nodes of g, and
no longer depends on the old g.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...gas_storage.bounds.regression import product
from ...gas_storage.prices.process import GaussianFactors
from ...gas_storage.references.marginal import (
    SLOW_REACH,
    FactorGrid,
    Transition,
    factor_grid,
    gauss_hermite,
    spline_weights,
    transition_weights,
)

TODAY = 15  # Gauss-Hermite nodes of g on the first date


class IndexTransition(NamedTuple):
    """From the nodes of a date to those of the next: `fast` [from, to] weights of f; `read`
    [from, to] those of g' = f, where g is renewed; `nodes`: how many of g there are before."""

    fast: np.ndarray
    read: np.ndarray | None
    nodes: int

    def expect(self, value: np.ndarray) -> np.ndarray:
        """Conditional expectation: [n, g to x f to] -> [n, g from x f from]."""
        count = len(value)
        moved = product(self.fast, value.reshape(-1, self.fast.shape[1]).T).T
        moved = moved.reshape(count, -1, len(self.fast))
        if self.read is not None:
            now = np.einsum("fg,ngf->nf", self.read, moved)[:, None]
            moved = np.broadcast_to(now, (count, self.nodes, now.shape[2]))
        return moved.reshape(count, -1)


class FirstDate(NamedTuple):
    """From the valuation date to the nodes of the first date."""

    weights: np.ndarray

    def expect(self, value: np.ndarray) -> np.ndarray:
        """[n, g x f] -> [n, 1]"""
        return value @ self.weights[:, None]


@dataclass(frozen=True, eq=False)
class IndexGrid:
    """Nodes: columns of a date run over g x f. `fast`: the nodes of f; `slow`: how many of g."""

    of: GaussianFactors
    fast: FactorGrid
    slow: int

    @classmethod
    def made(cls, of: GaussianFactors, spacing: float, slow: int) -> "IndexGrid":
        """`spacing` of f, in deviations of the shock of a step."""
        return cls(of, factor_grid(of._replace(index=None), (0,), spacing, 1), slow)

    @cached_property
    def _deviations(self) -> np.ndarray:
        return np.sqrt(self.of.covariance[:, 1, 1])

    def index_nodes(self, t: int) -> np.ndarray:
        """The nodes of g on a date: one where it is fixed today."""
        deviation = self._deviations[t]
        if deviation <= 1e-12:
            return np.zeros(1)
        return np.linspace(-1, 1, self.slow | 1) * SLOW_REACH * deviation

    def columns(self, t: int) -> int:
        """How many there are on a date."""
        return len(self.index_nodes(t)) * len(self.fast.fast)

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """[columns] spot prices of mean `forward`."""
        return np.tile(self.fast.spot(t, forward), len(self.index_nodes(t)))

    def index(self, t: int) -> np.ndarray:
        """[columns] the index."""
        return np.repeat(self.of.index.price(self.of, t, self.index_nodes(t)), len(self.fast.fast))

    def after(self, t: int) -> IndexTransition:
        """From a date to the next."""
        nodes, fast = self.index_nodes(t), self._fast(t + 1, self.fast.fast)
        if not self.of.index.carry[t + 1, 1, 0]:
            return IndexTransition(fast, None, len(nodes))
        return IndexTransition(fast, _read(self.index_nodes(t + 1), self.fast.fast), len(nodes))

    def start(self) -> FirstDate:
        """From the valuation date, where all factors are 0, to the first date."""
        (deviation, _), (below, rest) = self.of.shock[0]
        variance = below**2 + rest**2
        shocks, probabilities = gauss_hermite(np.sqrt(variance), TODAY)
        slope = below * deviation / variance if variance > 0 else 0.0
        left = np.sqrt(max(deviation**2 - slope * below * deviation, 0.0))
        fast = transition_weights(self.fast.fast, slope * shocks, left)
        weights = np.einsum("p,pg,pf->gf", probabilities, _read(self.index_nodes(0), shocks), fast)
        return FirstDate(weights.ravel())

    def _fast(self, into: int, points: np.ndarray) -> np.ndarray:
        deviation = self.of.shock[into, 0, 0]
        return transition_weights(self.fast.fast, self.of.decay[into, 0] * points, deviation)


class PairTransition(NamedTuple):
    """A `Transition` of two factors in small products, which OpenBLAS computes on one thread."""

    of: Transition

    def expect(self, value: np.ndarray) -> np.ndarray:
        """Conditional expectation: [n, second to x first to] -> [n, second from x first from]."""
        count, total = len(value), 0.0
        for slow, fast in self.of.terms:
            mean = product(fast, value.reshape(-1, fast.shape[1]).T)
            mean = mean.reshape(len(fast), count, -1).transpose(2, 1, 0)
            total = total + product(slow, mean.reshape(slow.shape[1], -1))
        every = np.reshape(total, (-1, count, len(self.of.terms[0][1])))
        return every.transpose(1, 0, 2).reshape(count, -1)


@dataclass(frozen=True, eq=False)
class PairGrid:
    """Nodes of two correlated factors, that of the spot price and that of a second commodity.

    Columns run over those of the second x those of the spot price.
    """

    of: GaussianFactors
    both: FactorGrid

    @classmethod
    def made(cls, of: GaussianFactors, spacing: float, slow: int) -> "PairGrid":
        """`spacing` of the spot price's, in deviations of the shock of a step; `slow`: how many of
        the second."""
        return cls(of, factor_grid(of._replace(index=None), (0, 1), spacing, slow))

    def columns(self, t: int) -> int:
        """How many there are."""
        return self.both.columns

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """[columns] spot prices of mean `forward`."""
        return self.both.spot(t, forward)

    def index(self, t: int) -> np.ndarray:
        """[columns] prices of the second commodity."""
        return np.repeat(self.of.index.price(self.of, t, self.both.slow), len(self.both.fast))

    def after(self, t: int) -> PairTransition:
        """From a date to the next."""
        return PairTransition(self.both.after(t))

    def start(self) -> PairTransition:
        """From the valuation date, where both factors are 0, to the first date."""
        return PairTransition(self.both.start())


def _read(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.ones((len(points), 1)) if len(nodes) == 1 else spline_weights(nodes, points)
