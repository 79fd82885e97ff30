"""The exact value: dynamic programming in the levels, modes and one or two price factors."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ...gas_storage.prices.process import GaussianFactors
from ...gas_storage.references.lattice import SLOW, Refined, coordinates, on_finer_grids
from ...gas_storage.references.marginal import FactorGrid, factor_grid
from ..core.contract import ContractLayout, StepPrices
from .grid import ContractGrid, arrived, best, grid_of
from .index_grid import IndexGrid, PairGrid

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
    """The value of a schedule with NumPy leaves; without `factors`, at forward prices.

    `parts` of the measure of the levels; `finer`, `slow`: nodes of the price factors.
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
    """Those that move prices, the fastest first."""
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
        raise ValueError(f"a lattice holds one or two price factors, and {count} move prices")
    return factor_grid(factors, selected, SPACINGS[count] / finer, slow)


def refined(layout: ContractLayout, schedule: Any, factors: GaussianFactors | None) -> Refined:
    """The value, each of its grids halved until that moves it by less than 0.001 %, or 0.005 % with
    two commodities."""
    index = None if factors is None else factors.index
    slow, enough = (SLOW, ENOUGH) if index is None or index.renewed else PAIR
    of_levels = partial(lattice, layout, schedule, factors, slow=slow)
    first = of_levels()
    if len(layout.levels) > 2 and not first.grid.exact:
        raise ValueError("there is no lattice of three levels without a practical common divisor")
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
