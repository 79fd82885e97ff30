"""The exact value: dynamic programming in the levels, modes and one or two price factors.

With a month-ahead index, nodes are pairs of a node of f, the factor of the spot price, and a node
of g, the factor of the index. Within a month g is constant: a step is the transition of f at each
node of g. At the start of a month g becomes f of the day before. The value on that date is
therefore read at g = f, by a cubic spline between nodes of g, and does not depend on the old g.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from ...gas_storage.bounds.regression import product
from ...gas_storage.prices.process import GaussianFactors
from ...gas_storage.references.lattice import SLOW, Refined, coordinates, on_finer_grids
from ...gas_storage.references.marginal import (
    SLOW_REACH,
    FactorGrid,
    Transition,
    factor_grid,
    gauss_hermite,
    spline_weights,
    transition_weights,
)
from ..core.contract import ContractLayout, StepPrices
from .grid import ContractGrid, arrived, best, grid_of

TODAY = 15  # Gauss-Hermite nodes of g on the first date


class IndexTransition(NamedTuple):
    """The transition from the nodes of a date to those of the next date. `fast` [from, to]: weights
    of f; `read` [from, to]: weights of the new g = f, None if g is not renewed; `nodes`: the number
    of nodes of g on the first date."""

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
    """The transition from the valuation date to the nodes of the first date."""

    weights: np.ndarray

    def expect(self, value: np.ndarray) -> np.ndarray:
        """The expectation: [n, g x f] -> [n, 1]."""
        return value @ self.weights[:, None]


@dataclass(frozen=True, eq=False)
class IndexGrid:
    """The nodes; the columns of a date run over g x f. `fast`: the nodes of f; `slow`: the number
    of nodes of g."""

    of: GaussianFactors
    fast: FactorGrid
    slow: int

    @classmethod
    def made(cls, of: GaussianFactors, spacing: float, slow: int) -> "IndexGrid":
        """The grid; `spacing`: the distance of the nodes of f, in standard deviations of the shock
        of a step."""
        return cls(of, factor_grid(of._replace(index=None), (0,), spacing, 1), slow)

    @cached_property
    def _deviations(self) -> np.ndarray:
        return np.sqrt(self.of.covariance[:, 1, 1])

    def index_nodes(self, t: int) -> np.ndarray:
        """The nodes of g on a date; one node if g is fixed today."""
        deviation = self._deviations[t]
        if deviation <= 1e-12:
            return np.zeros(1)
        return np.linspace(-1, 1, self.slow | 1) * SLOW_REACH * deviation

    def columns(self, t: int) -> int:
        """The number of nodes of g on a date."""
        return len(self.index_nodes(t)) * len(self.fast.fast)

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """[columns] the spot prices, with the mean `forward`."""
        return np.tile(self.fast.spot(t, forward), len(self.index_nodes(t)))

    def index(self, t: int) -> np.ndarray:
        """[columns] the index."""
        return np.repeat(self.of.index.price(self.of, t, self.index_nodes(t)), len(self.fast.fast))

    def after(self, t: int) -> IndexTransition:
        """The transition from a date to the next."""
        nodes, fast = self.index_nodes(t), self._fast(t + 1, self.fast.fast)
        if not self.of.index.carry[t + 1, 1, 0]:
            return IndexTransition(fast, None, len(nodes))
        return IndexTransition(fast, _read(self.index_nodes(t + 1), self.fast.fast), len(nodes))

    def start(self) -> FirstDate:
        """The transition from the valuation date, on which all factors are 0, to the first date."""
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
    """A `Transition` of two factors, split into small matrix products, which OpenBLAS computes on
    one thread."""

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
    """Nodes of two correlated factors: the factor of the spot price and the factor of the price of
    a second commodity. Columns are all pairs of a node of the second commodity and a node of the
    spot price.
    """

    of: GaussianFactors
    both: FactorGrid

    @classmethod
    def made(cls, of: GaussianFactors, spacing: float, slow: int) -> "PairGrid":
        """The grid; `spacing`: the distance of the nodes of the spot price, in standard deviations
        of the shock of a step; `slow`: the number of nodes of the second factor."""
        return cls(of, factor_grid(of._replace(index=None), (0, 1), spacing, slow))

    def columns(self, t: int) -> int:
        """The number of nodes."""
        return self.both.columns

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """[columns] the spot prices, with the mean `forward`."""
        return self.both.spot(t, forward)

    def index(self, t: int) -> np.ndarray:
        """[columns] prices of the second commodity."""
        return np.repeat(self.of.index.price(self.of, t, self.both.slow), len(self.both.fast))

    def after(self, t: int) -> PairTransition:
        """The transition from a date to the next."""
        return PairTransition(self.both.after(t))

    def start(self) -> PairTransition:
        """The transition from the valuation date, on which both factors are 0, to the first
        date."""
        return PairTransition(self.both.start())


def _read(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.ones((len(points), 1)) if len(nodes) == 1 else spline_weights(nodes, points)


ENOUGH = 1e-5  # of the value: a grid is fine enough when half its spacing moves the value by less
PAIR = 33, 5e-5  # nodes of a second commodity, and the same share: its first grid is finer
SPACINGS = {1: 0.3, 2: 0.3}  # of the fast factor's nodes, in deviations of the shock of a step


@dataclass(frozen=True, eq=False)
class Lattice:
    """The value of a contract, and the grid of its levels."""

    value: float
    grid: ContractGrid


def lattice(
    layout: ContractLayout,
    schedule: Any,
    factors: GaussianFactors | None,
    *,
    parts: int = 1,
    finer: int = 1,
    slow: int = SLOW,
    grid: ContractGrid | None = None,
) -> Lattice:
    """The value of a schedule with NumPy leaves; without `factors`, the value at forward prices.
    `parts`: into how many parts the measure of the levels is divided; `finer`: by how much the
    spacing of the price nodes is divided; `slow`: the number of nodes of the slow factor.
    """
    grid = grid_of(layout, schedule, parts) if grid is None else grid
    terms, horizon = schedule.steps.terms, len(schedule.steps.forward)
    prices = None if factors is None else _factor_grid(factors, finer, slow)
    columns = 1
    if prices is not None:
        columns = prices.columns if isinstance(prices, FactorGrid) else prices.columns(horizon)
    value = np.zeros((len(layout.modes), grid.size(horizon), columns))
    expected = schedule.steps.price.index.expected() if layout.indexed else None
    for t in reversed(range(horizon)):
        now = StepPrices(schedule.steps.forward[t, None], None if expected is None else expected[t])
        if prices is not None:
            index = None if isinstance(prices, FactorGrid) else prices.index(t)
            now = StepPrices(prices.spot(t, now.spot), index)
            flat = value.reshape(-1, value.shape[2])
            value = prices.after(t).expect(flat).reshape(*value.shape[:2], -1)
        after = arrived(grid.steps[t], value)
        value = best(grid.steps[t], layout, now.units(terms, t), now.moves(terms, t), after)
    today = value[0] if prices is None else prices.start().expect(value[0])
    return Lattice(float(today[0, 0]), grid)


def selected_factors(factors: GaussianFactors) -> tuple[int, ...]:
    """The factors that move prices, the fastest first."""
    moves = np.abs(factors.loading[:-1]).max(axis=0) > 0
    moves &= np.max(np.abs(factors.shock), axis=(0, 2)) > 0
    speed = np.argsort(factors.decay.mean(axis=0), kind="stable")
    return tuple(int(i) for i in speed if moves[i]) or (int(speed[0]),)


def _factor_grid(
    factors: GaussianFactors, finer: int, slow: int
) -> FactorGrid | IndexGrid | PairGrid:
    if factors.index is not None and not factors.index.renewed:
        return PairGrid.made(factors, SPACINGS[2] / finer, slow)
    if factors.index is not None:
        return IndexGrid.made(factors, SPACINGS[2] / finer, slow)
    selected = selected_factors(factors)
    count = coordinates(factors, selected)
    if count > 2:
        raise ValueError(f"a lattice supports one or two price factors, but prices have {count}")
    return factor_grid(factors, selected, SPACINGS[count] / finer, slow)


def refined(layout: ContractLayout, schedule: Any, factors: GaussianFactors | None) -> Refined:
    """The value and its error; the spacing of each grid is halved until the value changes by less
    than 0.001 %, or by less than 0.005 % with two commodities."""
    index = None if factors is None else factors.index
    slow, enough = (SLOW, ENOUGH) if index is None or index.renewed else PAIR
    of_levels = partial(lattice, layout, schedule, factors, slow=slow)
    first = of_levels()
    if len(layout.levels) > 2 and not first.grid.exact:
        raise ValueError(
            "a lattice of three levels needs a common divisor of the volumes with few enough nodes"
        )
    of_prices = partial(of_levels, grid=first.grid)
    finer: list[Callable[[int], Lattice]] = []
    if not first.grid.exact:
        finer.append(lambda n: of_levels(parts=n))
    if factors is not None:
        finer.append(lambda n: of_prices(finer=n))
        if factors.index is not None or coordinates(factors, selected_factors(factors)) > 1:
            finer.append(lambda n: of_prices(slow=(slow - 1) * n + 1))
    results = [on_finer_grids(first.value, partial(_value, side), enough) for side in finer]
    moved = sum(result.value - first.value for result in results)
    return Refined(first.value + moved, sum(result.error for result in results))


def _value(of: Callable[[int], Lattice], finer: int) -> float:
    return of(finer).value
