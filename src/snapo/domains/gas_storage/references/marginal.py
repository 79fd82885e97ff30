"""The marginal value of gas from the fastest price factor alone: the start of a policy."""

from dataclasses import dataclass

import numpy as np

from ..prices.process import GaussianFactors
from .day_terms import Interpolation, end_value, rates, unit_prices
from .factor_grid import FactorGrid, factor_grid
from .intrinsic import values_after
from .lattice_day import decide, free_volumes

# Inventory nodes of the dynamic program between two levels of the table.
BETWEEN = 3
# Where the fast factor's nodes of the quick program lie, in standard deviations of a daily shock.
SPACING = 0.6
# The quadratic is fitted, and to be trusted, within this many standard deviations of the factor.
FITTED = 3.0


@dataclass(frozen=True, eq=False)
class MarginalValues:
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] the day's `next_low` and `next_high`; level k of n lies at
      low + k / (n - 1) (high - low).
    - `coefficients`: [T, levels, 3]: c0 + c1 f + c2 f^2 in the fastest factor's state f on the
      day, the other factors at rest; currency per unit, discounted to the valuation date.
    - `reach`: [T] the |f| within which the quadratic was fitted; clip f to it.
    """

    low: np.ndarray
    high: np.ndarray
    coefficients: np.ndarray
    reach: np.ndarray


def marginal_values(
    schedule, factors: GaussianFactors | None, interpolation: Interpolation, levels: int = 16
) -> MarginalValues:
    """The table of a dynamic program in the fast factor; without factors of the intrinsic problem.

    Where a day leaves no choice of inventory (`low` = `high`) the value is the day's spot price.
    There must be a day.
    """
    if factors is None:
        found = _without_noise(schedule, interpolation, levels)
        reach = np.zeros(len(schedule.steps.forward))
    else:
        grid = factor_grid(factors, (factors.fast,), SPACING, 1)
        found, reach = _with_noise(schedule, interpolation, levels, grid), _reach(grid)
    steps = schedule.steps
    return MarginalValues(steps.next_low.copy(), steps.next_high.copy(), found, reach)


def _with_noise(
    schedule, interpolation: Interpolation, levels: int, grid: FactorGrid
) -> np.ndarray:
    steps, constants = schedule.steps, schedule.constants
    horizon, size = len(steps.forward), BETWEEN * (levels - 1) + 1
    table, reach = np.zeros((horizon, levels, 3)), _reach(grid)
    volumes = free_volumes(schedule, interpolation)
    nodes = _uniform(steps.next_low[-1], steps.next_high[-1], size)
    value = end_value(schedule, nodes[:, None], constants.end_forward * grid.noise(horizon))
    for t in reversed(range(horizon)):
        after = grid.after(t).expect(value)
        spot = steps.forward[t] * grid.noise(t)
        slope = steps.gas_discount[t] * spot + np.zeros((levels, 1))
        if len(nodes) > 1:
            slope = _slopes(nodes, after)
        table[t] = _quadratic(grid.fast, reach[t] / FITTED, slope)
        inventory = _uniform(steps.low[t], steps.high[t], size)
        day_rates, prices = rates(schedule, interpolation, t), unit_prices(schedule, t, spot)
        _, value = decide(schedule, day_rates, t, prices, inventory, nodes, after, volumes)
        nodes = inventory
    return table


def _without_noise(schedule, interpolation: Interpolation, levels: int) -> np.ndarray:
    steps = schedule.steps
    low = np.append(steps.low, steps.next_low[-1:])
    high = np.append(steps.high, steps.next_high[-1:])
    table = np.zeros((len(steps.forward), levels, 3))
    for t, line in enumerate(values_after(schedule, interpolation, low, high)):
        nodes = _uniform(low[t + 1], high[t + 1], BETWEEN * (levels - 1) + 1)
        table[t, :, 0] = steps.gas_discount[t] * steps.forward[t]
        if len(nodes) > 1:
            table[t, :, 0] = _slopes(nodes, line(nodes)[:, None])[:, 0]
    return table


def _reach(grid: FactorGrid) -> np.ndarray:
    """[T] three standard deviations of the factor on the day; early on, of half its widest."""
    deviation = np.sqrt(grid.covariance[:-1, 0, 0])
    return FITTED * np.maximum(deviation, 0.5 * deviation.max(initial=0.0))


def _uniform(low: float, high: float, size: int) -> np.ndarray:
    return np.linspace(low, high, size) if high > low else np.array([low])


def _slopes(nodes: np.ndarray, value: np.ndarray) -> np.ndarray:
    """[levels, columns] slopes at the levels, over one node to each side that has one."""
    centre = np.arange(0, len(nodes), BETWEEN)
    left, right = np.maximum(centre - 1, 0), np.minimum(centre + 1, len(nodes) - 1)
    return (value[right] - value[left]) / (nodes[right] - nodes[left])[:, None]


def _quadratic(states: np.ndarray, deviation: float, values: np.ndarray) -> np.ndarray:
    """Least squares of values [levels, columns] on 1, f, f^2, weighted by the factor's density."""
    found = np.zeros((len(values), 3))
    if len(states) < 3 or deviation == 0:
        found[:, 0] = values[:, len(states) // 2]
        return found
    unit = states / deviation
    weight = np.where(np.abs(unit) <= FITTED, np.exp(-(unit**2) / 4), 0.0)
    design = weight[:, None] * np.stack([np.ones_like(unit), unit, unit**2], axis=1)
    solved = np.linalg.lstsq(design, (weight * values).T, rcond=None)[0].T
    return solved / deviation ** np.arange(3)
