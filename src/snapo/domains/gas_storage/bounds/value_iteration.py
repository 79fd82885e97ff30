"""Fitted value iteration: the value of gas as functions of Gaussian price factors, day by day.

Its marginal values are the baseline of a policy. The expectation of the fitted value has hinges
that the noise of a day has smoothed; polynomials approximate them, so that a policy computes few
numbers.

The daily innovations of the fitted value are a control variate. They have mean zero for every
policy (Rogers, Mathematical Finance 12 (2002); Andersen and Broadie, Management Science 50 (2004)),
and remove a large part of the variance if the fit is good.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..prices.process import GaussianFactors
from ..references.day_terms import Interpolation, end_value, rates, unit_prices, volume_scale
from ..references.lattice_day import inventory_nodes
from ..references.marginal import slope_table
from ..references.piecewise import visited
from .day_grid import DayGrid, best_value, day_grids, days_between, largest_rate, spacing_of
from .regression import AnyBasis, AnyRegression, Recent, basis_of, regression_of

# All that the grids follow from. A name that is missing here would leave old grids in use.
STEPS = (
    "levels", "injection_rate", "withdrawal_rate", "min_injection", "min_withdrawal",
    "inventory_loss", "high", "next_low", "next_high", "inventory_cost", "flow_discount",
)  # fmt: skip
CONSTANTS = ("inventory", "end_levels")

_last: Recent[list[DayGrid]] = Recent(2)  # those of the case, and of another input


def regular_grids(schedule, interpolation: Interpolation, inventories: int) -> list[DayGrid]:
    """The grids of all T days, with about `inventories` points at equal distances and the ratchet
    rows.

    They contain only inventories that can be reached from the present inventory.
    """
    key = interpolation, inventories, *_numbers(schedule)
    return _last.of(key, lambda: _made(schedule, interpolation, inventories))


def _made(schedule, interpolation: Interpolation, inventories: int) -> list[DayGrid]:
    horizon = len(schedule.steps.forward)
    low, high = visited(schedule, interpolation)
    spacing = spacing_of(schedule, inventories, float(np.max(high - low)))
    day_rates = [rates(schedule, interpolation, t) for t in range(horizon)]
    levels = [day.levels for day in day_rates] + [schedule.constants.end_levels]
    nodes = [inventory_nodes(*level[:2], spacing, level[2]) for level in zip(low, high, levels)]
    return days_between(schedule, day_rates, nodes, bends=False)


def _numbers(schedule) -> list[bytes]:
    parts = (schedule.steps, STEPS), (schedule.constants, CONSTANTS)
    return [np.asarray(getattr(part, name)).tobytes() for part, names in parts for name in names]


INVENTORIES = 101
FEWEST, A_DAY = 51, 2  # in a value table: inventories, and nodes passed by a day's largest flow


@dataclass(frozen=True, eq=False)
class FittedValue:
    """The value of the contract at the start of each day and on the end date.

    - `regression`: the regression on `basis`, K functions of the price factors.
    - `nodes`: T + 1 grids of inventories; `coefficients`: [n, K] on each grid, linear between
      nodes.
    - `value`: an approximation of the present value on the valuation date, before fixed costs.
    """

    regression: AnyRegression
    nodes: list[np.ndarray]
    coefficients: list[np.ndarray]
    value: float

    @property
    def basis(self) -> AnyBasis:
        return self.regression.basis

    def at(self, t: int, inventory: np.ndarray) -> np.ndarray:
        """[n, K] coefficients on day t at these inventories."""
        return interpolated(self.nodes[t], self.coefficients[t], inventory)


def fit_value(
    schedule,
    factors: GaussianFactors,
    interpolation: Interpolation,
    inventories: int = INVENTORIES,
) -> FittedValue:
    """The fitted value: backwards in time, the value of the best flow on quadrature nodes is
    regressed on the basis.

    The continuation value is the expectation of the fitted functions in closed form, so that only
    the fit is an approximation (Tsitsiklis and Van Roy, IEEE Transactions on Neural Networks 12
    (2001)). There must be at least one decision day.
    """
    days = day_grids(schedule, interpolation, inventories, bends=False)
    return _fitted(schedule, factors, days)


def fit_value_table(
    schedule, factors: GaussianFactors, interpolation: Interpolation
) -> FittedValue:
    """The fitted value for the value table of a policy, on a coarser grid with at least half as
    many nodes, none of them at bends.

    A policy that reads this grid loses almost nothing (for the store of the template less than 1e-5
    of its value). An upper bound would become less tight; it uses `fit_value`.
    """
    rate = largest_rate(schedule)
    passed = A_DAY * volume_scale(schedule) / rate if rate else INVENTORIES
    inventories = int(np.clip(np.ceil(passed) + 1, FEWEST, INVENTORIES))
    return _fitted(schedule, factors, regular_grids(schedule, interpolation, inventories))


def _fitted(schedule, factors: GaussianFactors, days: list[DayGrid]) -> FittedValue:
    steps, constants = schedule.steps, schedule.constants
    horizon = len(days)
    basis = basis_of(factors, constants.end_fraction != 0)
    available = regression_of(basis)
    nodes = [day.nodes for day in days] + [days[-1].after]
    spot = available.spot(horizon, constants.end_forward)
    value = end_value(schedule, nodes[horizon][:, None], spot)
    coefficients = [np.zeros((0, 0))] * (horizon + 1)
    for t in reversed(range(horizon + 1)):
        coefficients[t] = available.fitted(t, value)
        if t:
            prices = unit_prices(schedule, t - 1, available.spot(t - 1, steps.forward[t - 1]))
            value = best_value(
                days[t - 1],
                prices,
                available.expected(t - 1, coefficients[t]),
                above=False,
            )
    return FittedValue(available, nodes, coefficients, float((coefficients[0] @ basis.first)[0]))


def interpolated(nodes: np.ndarray, table: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The rows of a table [m, K] at points [n]: linear between the rising nodes [m], and constant
    outside them."""
    if nodes.size == 1:
        return np.broadcast_to(table, (len(points), table.shape[1]))
    position = np.interp(points, nodes, np.arange(nodes.size, dtype=float))
    left = np.minimum(position.astype(int), nodes.size - 2)
    share = (position - left)[:, None]
    return (1 - share) * table[left] + share * table[left + 1]


class FittedMarginal(NamedTuple):
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] the range of the table, see `SlopeTable`.
    - `above`, `below`: [T, rows, n] coefficients on either side of a row, for the polynomials of
      the basis times its exponential and, if the basis has one, for the constant.
    - `whiten`: [T, kept, F], `common` [T, F], `shift` [T]: y = whiten f, ln g = common f - shift.
    - `exponents`, `exponents_ahead`: the exponents of functions of spikes, if there are any, see
      `SpikeBasis`.
    """

    low: np.ndarray
    high: np.ndarray
    above: np.ndarray
    below: np.ndarray
    whiten: np.ndarray
    common: np.ndarray
    shift: np.ndarray
    exponents: np.ndarray | None = None
    exponents_ahead: np.ndarray | None = None


def fitted_marginal(schedule, fitted_value: FittedValue) -> FittedMarginal:
    """The table of the slopes of a fitted value; outside its inventories the last slope
    continues."""
    available, steps = fitted_value.regression, schedule.steps
    horizon, rows, basis = len(steps.forward), slope_table(schedule), available.basis
    table = np.zeros((2, horizon, rows.rows, basis.plain))
    for t in range(horizon):
        nodes, drift = fitted_value.nodes[t + 1], available.drift(t)
        if nodes.size == 1:  # no choice of inventory: the spot is as good as any
            table[:, t, :, 0] = steps.gas_discount[t] * steps.forward[t]
            continue
        sides = rows.slopes(t, partial(fitted_value.at, t + 1), nodes[0], nodes[-1])
        table[:, t] = [slope @ drift for slope in sides]
    linear = basis.linear()
    return FittedMarginal(rows.low, rows.high, *table, *(x[:horizon] for x in linear))


INNOVATION_LEVELS = 16


class InnovationTable(NamedTuple):
    """The value on T days and on the end date, as a function of inventory and price factors.

    - `low`, `high`: [T + 1] the interval of the evenly spaced levels; beyond it the value is
      constant.
    - `now`: [T + 1, levels, n] the coefficients of the functions of `FittedMarginal`, in present
      values.
    - `ahead`: [T, levels, n] coefficients of the expectation of the value a day before, on the
      levels of the next date.
    - `first`: the expectation, on the valuation date, of the value on the first day.
    - `whiten`, `common`, `shift`, exponents: [T + 1, …], as in `FittedMarginal`.
    """

    low: np.ndarray
    high: np.ndarray
    now: np.ndarray
    ahead: np.ndarray
    first: float
    whiten: np.ndarray
    common: np.ndarray
    shift: np.ndarray
    exponents: np.ndarray | None = None
    exponents_ahead: np.ndarray | None = None


def innovation_table(fitted_value: FittedValue, levels: int = INNOVATION_LEVELS) -> InnovationTable:
    """The table of the innovations of a fitted value."""
    available, dates = fitted_value.regression, len(fitted_value.nodes)
    basis = available.basis
    low, high = (np.array([nodes[end] for nodes in fitted_value.nodes]) for end in (0, -1))
    now = np.stack(
        [
            fitted_value.at(t, np.linspace(low[t], high[t], levels)) @ available.plain(t)
            for t in range(dates)
        ]
    )
    ahead = basis.expected_coefficients(now[1:])
    first = float(now[0, 0] @ basis.plain_first)
    return InnovationTable(low, high, now, ahead, first, *basis.linear())
