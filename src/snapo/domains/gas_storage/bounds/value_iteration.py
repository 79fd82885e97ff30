"""Fitted value iteration: the value of gas as functions of Gaussian price factors, day by day."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from ..prices.process import GaussianFactors
from ..references.day_terms import Interpolation, end_value, interpolation_matrix, unit_prices
from .basis import REACH, Basis, gaussian_basis
from .best_flow import best_value
from .day_grid import day_grids
from .product import product

INVENTORIES = 101
ALONE, FAST = 121, 37  # uniform nodes of the fast factor, to REACH standard deviations
COUNTS = {
    1: (),
    2: (6,),
    3: (6, 5),
}  # Gauss-Hermite nodes of the others; more of them: Sobol points
POINTS = 1024
LEVELS = 2  # nodes of the factor in the exponential
RIDGE = 1e-11  # of the regression, against the sum of squares of the functions


@dataclass(frozen=True, eq=False)
class FittedValue:
    """The value of the contract at the start of each day and on the end date.

    - `basis`: K functions of the price factors.
    - `nodes`: T + 1 grids of inventories; `coefficients`: [n, K] on each, linear between nodes.
    - `value`: on the valuation date, in present money, before fixed costs. An approximation.
    """

    basis: Basis
    nodes: list[np.ndarray]
    coefficients: list[np.ndarray]
    value: float

    def at(self, t: int, inventory: np.ndarray) -> np.ndarray:
        """[n, K] coefficients on day t at these inventories."""
        return interpolation_matrix(self.nodes[t], inventory) @ self.coefficients[t]


def fit_value(
    schedule,
    factors: GaussianFactors,
    interpolation: Interpolation,
    inventories: int = INVENTORIES,
) -> FittedValue:
    """Backwards in time, the value of the best flow on quadrature nodes, regressed on the basis.

    The continuation is the basis' own expectation, so that only the fit is an approximation:
    Tsitsiklis and Van Roy, IEEE Transactions on Neural Networks 12 (2001). There must be a day.
    """
    steps, constants = schedule.steps, schedule.constants
    horizon = len(steps.forward)
    basis = gaussian_basis(factors, constants.end_fraction != 0)
    days = day_grids(schedule, interpolation, inventories, bends=False)
    y, level, weight = states_of(basis)
    known = basis.polynomials(y[None])  # the same points every day
    nodes = [day.nodes for day in days] + [days[-1].after]
    spot = constants.end_forward * _noise(basis, horizon, y, level)
    value = end_value(schedule, nodes[horizon][:, None], spot)
    coefficients = [np.zeros((0, 0))] * (horizon + 1)
    for t in reversed(range(horizon + 1)):
        here = scaled(basis, t, basis.of_whitened(y[None], slice(t, t + 1), known)[0], level)
        coefficients[t] = regress(here, value, weight)
        if t:
            ahead = basis.ahead_of_whitened(y[None], slice(t - 1, t), known)[0]
            ahead = scaled(basis, t - 1, ahead, level)
            spot = steps.forward[t - 1] * _noise(basis, t - 1, y, level)
            prices = unit_prices(schedule, t - 1, spot)
            value = best_value(days[t - 1], prices, product(coefficients[t], ahead), above=False)
    return FittedValue(basis, nodes, coefficients, float((coefficients[0] @ basis.first)[0]))


def states_of(basis: Basis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened factors [kept, Q], standardised ln g [Q], and weights of the regression [Q]."""
    levels = LEVELS if basis.common else 1
    kept = len(basis.kept)
    if kept not in COUNTS:
        points = qmc.Sobol(kept + 1, rng=np.random.default_rng(0)).random(POINTS).T
        z = ndtri(np.clip(points, 2.0**-31, 1 - 2.0**-31))
        return z[:kept], z[kept] * bool(basis.common), np.ones(POINTS)
    fast = np.linspace(-REACH, REACH, ALONE if kept == 1 else FAST)
    grids = [(fast, np.exp(-(fast**2) / 2))]
    grids += [_gauss_hermite(count) for count in (*COUNTS[kept], levels)]
    axes = np.meshgrid(*(grid[0] for grid in grids), indexing="ij")
    mass = np.meshgrid(*(grid[1] for grid in grids), indexing="ij")
    z = np.stack([axis.ravel() for axis in axes])
    return z[:-1], z[-1], np.prod(mass, axis=0).ravel()


def _gauss_hermite(count: int) -> tuple[np.ndarray, np.ndarray]:
    points, weights = np.polynomial.hermite_e.hermegauss(count)
    return points, weights / weights.sum()


def _noise(basis: Basis, t: int, y: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Spot over forward price [Q] on day t."""
    log = basis.of.loading[t][list(basis.kept)] @ basis.back(t) @ y
    log += basis.level_deviation(t) * level * bool(basis.common)
    return np.exp(log - basis.of.variance[t] / 2)


def scaled(basis: Basis, t: int, found: np.ndarray, level: np.ndarray) -> np.ndarray:
    """[K, Q] functions from their polynomials."""
    if not basis.common:
        return found
    deviation = basis.level_deviation(t)
    scale = np.exp(deviation * level - deviation**2 / 2)
    return np.concatenate([scale * found, np.ones((1, found.shape[1]))])


def regress(functions: np.ndarray, value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """[n, K] coefficients of weighted least squares of values [n, Q]; small where undetermined."""
    weighed = functions * weight
    normal = product(weighed, functions.T)
    normal[np.diag_indices_from(normal)] += RIDGE * np.trace(normal)
    return product(np.linalg.inv(normal), product(weighed, value.T)).T
