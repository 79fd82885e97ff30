"""The marginal value of gas from the fastest price factor alone: the start of a policy."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..prices.process import GaussianFactors
from .day_terms import Interpolation, end_value, interpolation_matrix, rates, unit_prices
from .factor_grid import FactorGrid, factor_grid
from .intrinsic import values_after
from .lattice_day import decide, free_volumes
from .slope_table import ROWS, SlopeTable, slope_table

# Where the fast factor's nodes of the quick program lie, in standard deviations of a daily shock.
SPACING = 0.6
# The polynomial is fitted, and to be trusted, within this many standard deviations of the factor.
FITTED = 3.0
DEGREE = 4  # of it; with 2 a store of fast corners was worth 0.3 % less than it can be, now 0.04 %


@dataclass(frozen=True, eq=False)
class MarginalValues:
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] of the table, see `SlopeTable`; row k of n lies at
      low + k / (n - 1) (high - low).
    - `above`, `below`: [T, rows, n] on either side: c0 + c1 f + c2 f^2 + … in the fastest
      factor's state f on the day, the other factors at rest; currency per unit, discounted to
      the valuation date.
    - `reach`: [T] the |f| within which the polynomial was fitted; clip f to it.
    """

    low: np.ndarray
    high: np.ndarray
    above: np.ndarray
    below: np.ndarray
    reach: np.ndarray


def marginal_values(
    schedule, factors: GaussianFactors | None, interpolation: Interpolation
) -> MarginalValues:
    """The table of a dynamic program in the fast factor; without factors of the intrinsic problem.

    Where a day leaves no choice of inventory (`low` = `high`) the value is the day's spot price.
    There must be a day.
    """
    table = slope_table(schedule)
    if factors is None:
        without_noise = _without_noise(schedule, interpolation, table)
        reach = np.zeros(len(schedule.steps.forward))
    else:
        grid = factor_grid(factors, (factors.fast,), SPACING, 1)
        without_noise, reach = _with_noise(schedule, interpolation, table, grid), _reach(grid)
    above, below = without_noise
    return MarginalValues(table.low, table.high, above, below, reach)


def _with_noise(
    schedule, interpolation: Interpolation, table: SlopeTable, grid: FactorGrid
) -> np.ndarray:
    """[2, T, rows, n] above and below."""
    steps, constants = schedule.steps, schedule.constants
    horizon = len(steps.forward)
    polynomials, reach = np.zeros((2, horizon, ROWS, DEGREE + 1)), _reach(grid)
    volumes = free_volumes(schedule, interpolation)
    nodes = table.nodes(horizon - 1)
    value = end_value(schedule, nodes[:, None], constants.end_forward * grid.noise(horizon))
    for t in reversed(range(horizon)):
        after = grid.after(t).expect(value)
        spot = steps.forward[t] * grid.noise(t)
        sides = np.zeros((2, ROWS, 1)) + steps.gas_discount[t] * spot
        if len(nodes) > 1:
            at = partial(_interpolated, nodes, after)
            sides = table.slopes(t, at, nodes[0], nodes[-1])
        for side, slope in enumerate(sides):
            polynomials[side, t] = _polynomial(grid.fast, reach[t] / FITTED, slope)
        if t:
            inventory = table.nodes(t - 1)
            day_rates, prices = rates(schedule, interpolation, t), unit_prices(schedule, t, spot)
            _, value = decide(schedule, day_rates, t, prices, inventory, nodes, after, volumes)
            nodes = inventory
    return polynomials


def _without_noise(schedule, interpolation: Interpolation, table: SlopeTable) -> np.ndarray:
    """[2, T, rows, n] above and below."""
    steps = schedule.steps
    low = np.append(steps.low, steps.next_low[-1:])
    high = np.append(steps.high, steps.next_high[-1:])
    slopes = np.zeros((2, len(steps.forward), ROWS, DEGREE + 1))
    for t, line in enumerate(values_after(schedule, interpolation, low, high)):
        slopes[:, t, :, 0] = steps.gas_discount[t] * steps.forward[t]
        if high[t + 1] > low[t + 1]:
            slopes[:, t, :, 0] = table.slopes(t, line, low[t + 1], high[t + 1])
    return slopes


def _interpolated(nodes: np.ndarray, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    return interpolation_matrix(nodes, points) @ values


def _reach(grid: FactorGrid) -> np.ndarray:
    """[T] three standard deviations of the factor on the day; early on, of half its widest."""
    deviation = np.sqrt(grid.covariance[:-1, 0, 0])
    return FITTED * np.maximum(deviation, 0.5 * deviation.max(initial=0.0))


def _polynomial(states: np.ndarray, deviation: float, values: np.ndarray) -> np.ndarray:
    """Least squares of values [rows, columns] on powers of f, weighted by the factor's density."""
    polynomial = np.zeros((len(values), DEGREE + 1))
    if len(states) <= DEGREE or deviation == 0:
        polynomial[:, 0] = values[:, len(states) // 2]
        return polynomial
    unit = states / deviation
    weight = np.where(np.abs(unit) <= FITTED, np.exp(-(unit**2) / 4), 0.0)
    design = weight[:, None] * unit[:, None] ** np.arange(DEGREE + 1)
    solved = np.linalg.lstsq(design, (weight * values).T, rcond=None)[0].T
    return solved / deviation ** np.arange(DEGREE + 1)
