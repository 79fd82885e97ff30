"""The fitted value: least squares of the value of the best move on functions of the price factors.

Backwards in time, on nodes of the levels and quadrature nodes of the factors. The expectation of
the functions a step later has a closed form, so that only the fit is an approximation (Tsitsiklis
and Van Roy, IEEE Transactions on Neural Networks 12, 2001). The tables of `value_tables.py` for the
policy, and the penalty of the upper bound, are made from the fitted value.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...gas_storage.bounds.regression import (
    AnyBasis,
    AnyRegression,
    Regression,
    basis_of,
    regression_of,
)
from ...gas_storage.prices.process import GaussianFactors
from ..core.contract import ContractLayout, StepPrices
from .grid import ContractGrid, arrived, best


@dataclass(frozen=True, eq=False)
class FittedContract:
    """The value at the start of each of T steps, and after the last one.

    - `coefficients`: T + 1 arrays [modes, nodes, K], the coefficients of the functions of `basis`.
    - `value`: today's value, an approximation.
    """

    basis: AnyBasis
    grid: ContractGrid
    coefficients: list[np.ndarray]
    value: float

    @property
    def available(self) -> AnyRegression:
        """The regression with which the value was fitted."""
        return regression_of(self.basis)


def backwards(
    layout: ContractLayout, schedule: Any, factors: GaussianFactors, grid: ContractGrid
) -> Iterator[tuple[int, np.ndarray]]:
    """The fitted value of a schedule (NumPy leaves, at least one step). Yields the number of each
    step, from the last to the first, with the coefficients [modes, nodes, K] at its start."""
    terms, horizon = schedule.steps.terms, len(grid.steps)
    basis = basis_of(factors, priced=False)
    available, size = regression_of(basis), basis.size
    later = np.zeros((len(layout.modes), grid.size(horizon), size))
    yield horizon, later
    for t in reversed(range(horizon)):
        step = grid.steps[t]
        value = available.expected(t, later.reshape(-1, size))
        after = arrived(step, value.reshape(*later.shape[:2], -1))
        prices = StepPrices(
            available.spot(t, schedule.steps.forward[t]), _index(available, factors, t)
        )
        value = best(step, layout, prices.units(terms, t), prices.moves(terms, t), after)
        value[~np.isfinite(value)] = 0.0
        flat = value.reshape(-1, value.shape[2])
        later = available.fitted(t, flat).reshape(*value.shape[:2], size)
        yield t, later


def fit(
    layout: ContractLayout, schedule: Any, factors: GaussianFactors, grid: ContractGrid
) -> FittedContract:
    """The fitted value of a schedule with NumPy leaves, with the coefficients of all steps."""
    horizon, basis = len(grid.steps), basis_of(factors, priced=False)
    shapes = [(len(layout.modes), grid.size(t), basis.size) for t in range(horizon + 1)]
    coefficients = _room(shapes)
    for t, rows in backwards(layout, schedule, factors, grid):
        coefficients[t][:] = rows
    return FittedContract(basis, grid, coefficients, float(coefficients[0][0, 0] @ basis.first))


def _room(shapes: list[tuple[int, ...]]) -> list[np.ndarray]:
    """Arrays of these shapes as parts of one large array: the memory of one large array returns to
    the system, that of many small arrays often does not."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    parts = np.split(np.empty(ends[-1]), ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes)]


def _index(available: AnyRegression, factors: GaussianFactors, t: int) -> np.ndarray | None:
    """[Q] the index on the nodes; the last factor of the nodes is that of the index."""
    if factors.index is None or not isinstance(available, Regression):
        return None
    return factors.index.at(factors, t, available.basis.back(t) @ available.y)
