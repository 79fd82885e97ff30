"""The marginal value of gas from the fastest price factor only, and the grids of its factors.

The fast factor has a fine uniform grid, on which the trapezoidal rule is used with the exact
transition density. For a smooth integrand its error falls faster than any power of the spacing
(Trefethen and Weideman, SIAM Review 56, 2014); the kinks of decisions add an error of the order of
the spacing squared. The slow factor has few nodes, with Gauss-Hermite quadrature of a cubic spline
through them.

The value of a store that is filled and emptied by fixed daily volumes has corners at the multiples
of these volumes. The value of the next unit injected is the slope above the corner, and the value
of the last unit withdrawn is the slope below it. If volumes have a common measure, the rows of the
table of slopes are on the corners and half-way between them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ..prices.process import GaussianFactors
from ..prices.spikes import spike_nodes, spike_weights
from .day_terms import Interpolation, end_value, rates, unit_prices
from .intrinsic import values_after
from .lattice_day import decide, free_volumes, interpolation_matrix

# Where a grid ends, in standard deviations of its factor at its widest.
FAST_REACH, SLOW_REACH = 6.0, 4.5
# The trapezoidal rule needs a transition at least this wide, in spacings of the grid.
NARROW = 0.7
MAX_NODES = 401


class Transition(NamedTuple):
    """A transition as a sum of products, one for each term: slow weights [from, to] x fast weights
    [from, to]."""

    terms: list[tuple[np.ndarray, np.ndarray]]

    def expect(self, value: np.ndarray) -> np.ndarray:
        """Conditional expectation: [n, slow to x fast to] -> [n, slow from x fast from]."""
        total = 0.0
        for slow, fast in self.terms:
            moved = value.reshape(-1, slow.shape[1], fast.shape[1]) @ fast.T
            total = total + (slow @ moved if slow.size > 1 else slow[0, 0] * moved)
        return np.reshape(total, (len(value), -1))

    def spread(self, weight: np.ndarray) -> np.ndarray:
        """The transpose of `expect`: the probabilities of the nodes a day later."""
        total = 0.0
        for slow, fast in self.terms:
            moved = weight.reshape(-1, slow.shape[0], fast.shape[0]) @ fast
            total = total + (slow.T @ moved if slow.size > 1 else slow[0, 0] * moved)
        return np.reshape(total, (len(weight), -1))


@dataclass(frozen=True, eq=False)
class FactorGrid:
    """Nodes of the factors on the grid, the same on all days; columns are all pairs of a slow and a
    fast node. If prices have spikes, the spikes are the slow coordinate.

    - `of`: all factors of the price process; `selected`: indices of the factors on the grid, the
      fast factor first.
    - `fast`, `slow`: node positions (slow: one node at 0 if there is one coordinate).
    - `covariance`: [T + 1, kept, kept] the covariance of the factors on the grid on each day, and
      on the end date.
    """

    of: GaussianFactors
    selected: tuple[int, ...]
    fast: np.ndarray
    slow: np.ndarray
    covariance: np.ndarray
    _known: dict = field(default_factory=dict)

    @property
    def columns(self) -> int:
        return len(self.slow) * len(self.fast)

    def spot(self, t: int, forward: np.ndarray) -> np.ndarray:
        """The spot prices [columns] on day t (T for the end date), with the mean `forward`."""
        return self.of.spot(forward, self.noise(t))

    def by_forward(self, t: int) -> np.ndarray:
        """The derivatives [columns] of the spot price of day t with respect to its forward
        price."""
        return self.of.by_forward(self.noise(t))

    def noise(self, t: int) -> np.ndarray:
        """The random part of the spot price [columns] on day t."""
        loading = self.of.loading[t][list(self.selected)]
        variance = loading @ self.covariance[t] @ loading
        log = loading[0] * self.fast[None, :]
        if self.of.spikes is not None:
            log = log + (self.slow[:, None] - self.of.spikes.compensator[t])
        elif len(self.selected) > 1:
            log = log + loading[1] * self.slow[:, None]
        return self.of.noise(log, variance).ravel()

    def start(self) -> Transition:
        """The transition from the valuation date, on which all factors are 0, to the first day (one
        row)."""
        return self._transition(0, np.zeros(1), np.zeros(1))

    def after(self, t: int) -> Transition:
        """The transition from day t to the next day, or to the end date."""
        return self._transition(t + 1, self.slow, self.fast)

    def _transition(self, into: int, slow, fast) -> Transition:
        selected, decay, shock = list(self.selected), self.of.decay[into], self.of.shock[into]
        covariance = (shock @ shock.T)[np.ix_(selected, selected)]
        key = (len(slow), len(fast), *(f"{x:.9e}" for x in [*decay[selected], *covariance.ravel()]))
        if key not in self._known:
            self._known[key] = _weights(self, decay[selected], covariance, slow, fast)
        return self._known[key]


def factor_grid(
    of: GaussianFactors, selected: tuple[int, ...], spacing: float, slow_nodes: int
) -> FactorGrid:
    """The grid for one or two factors; `spacing`: in standard deviations of the daily shock of the
    fast factor."""
    covariance = _covariance(of, list(selected))
    widest = np.sqrt(np.max(covariance[:, range(len(selected)), range(len(selected))], axis=0))
    shocks = of.shock[:, selected[0]]
    daily = np.sqrt(np.sum(shocks**2, axis=1))
    daily = daily[daily > 1e-12 * max(widest[0], 1e-300)]
    fast = np.zeros(1)
    if len(daily) and widest[0] > 0:
        half = FAST_REACH * widest[0] / (spacing * daily.min())
        fast = np.linspace(-1, 1, 2 * min(int(np.ceil(half)), MAX_NODES // 2) + 1)
        fast = FAST_REACH * widest[0] * fast
    slow = np.zeros(1)
    if of.spikes is not None:
        slow = spike_nodes(of.spikes, 2 * slow_nodes)
    elif len(selected) > 1 and widest[1] > 0:
        slow = np.linspace(-1, 1, slow_nodes | 1) * SLOW_REACH * widest[1]
    return FactorGrid(of, tuple(selected), fast, slow, covariance)


def _covariance(of: GaussianFactors, selected: list[int]) -> np.ndarray:
    covariance, covariances = np.zeros((len(selected), len(selected))), []
    for decay, shock in zip(of.decay[:, selected], of.shock[:, selected], strict=True):
        covariance = np.outer(decay, decay) * covariance + shock @ shock.T
        covariances.append(covariance)
    return np.array(covariances)


def _weights(grid: FactorGrid, decay, covariance, slow, fast) -> Transition:
    """The weights. Independent factors need one term; correlated factors need a term for each shock
    of the slow factor."""
    if grid.of.spikes is not None:
        local = transition_weights(grid.fast, decay[0] * fast, np.sqrt(covariance[0, 0]))
        return Transition([(spike_weights(grid.of.spikes, grid.slow, slow), local)])
    if len(grid.slow) == 1:
        local = transition_weights(grid.fast, decay[0] * fast, np.sqrt(covariance[0, 0]))
        return Transition([(np.ones((1, 1)), local)])
    shocks, probabilities = gauss_hermite(np.sqrt(covariance[1, 1]), 3)
    positions = [spline_weights(grid.slow, decay[1] * slow + shock) for shock in shocks]
    if covariance[0, 1] == 0:
        moved = np.tensordot(probabilities, np.array(positions), axes=1)
        local = transition_weights(grid.fast, decay[0] * fast, np.sqrt(covariance[0, 0]))
        return Transition([(moved, local)])
    slope = covariance[0, 1] / covariance[1, 1]
    rest = np.sqrt(max(covariance[0, 0] - slope * covariance[0, 1], 0.0))
    terms = zip(shocks, probabilities, positions, strict=True)
    return Transition(
        [
            (share * position, transition_weights(grid.fast, decay[0] * fast + slope * shock, rest))
            for shock, share, position in terms
        ]
    )


def transition_weights(nodes: np.ndarray, mean: np.ndarray, deviation: float) -> np.ndarray:
    """The weights [points, nodes] of the expectation over N(mean, deviation^2)."""
    if len(nodes) == 1:
        return np.ones((len(mean), 1))
    if deviation < NARROW * (nodes[1] - nodes[0]):
        shocks, probabilities = gauss_hermite(deviation, 7)
        positions = [spline_weights(nodes, mean + shock) for shock in shocks]
        return np.tensordot(probabilities, np.array(positions), axes=1)
    density = np.exp(-0.5 * ((nodes[None, :] - mean[:, None]) / deviation) ** 2)
    return density / density.sum(axis=1, keepdims=True)


def gauss_hermite(deviation: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The shocks and their probabilities; one shock of 0 if there is no noise."""
    if deviation == 0:
        return np.zeros(1), np.ones(1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return deviation * nodes, weights / weights.sum()


def spline_weights(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Natural cubic spline interpolation as weights [points, nodes], constant outside the nodes."""
    from scipy.interpolate import CubicSpline  # late: few cases need it, and it loads slowly

    spline = CubicSpline(nodes, np.eye(len(nodes)), bc_type="natural")
    return spline(np.clip(points, nodes[0], nodes[-1]))


PIECES = 16  # between the levels of a table; twice as many where only these are on all corners
THIRD = 3  # parts of a piece: a slope at a corner is taken over one part
COMMON, DIVISORS = 0.05, 4  # how near daily volumes are to multiples of which part of the least
FINE = 8  # the smallest part, of a table with twice as many pieces


class SlopeTable(NamedTuple):
    """The rows of a table of slopes, by day.

    - `low`, `high`: [T] the first and the last row; the rows between are evenly spaced.
    - `next_low`, `next_high`: [T] the smallest and the largest inventory at the end of the day.
    - `corners`: whether levels are on corners, where the slope has two sides.
    - `segments`: the number of segments; a segment is between two levels, and rows are at the
      levels and half-way between them.
    """

    low: np.ndarray
    high: np.ndarray
    next_low: np.ndarray
    next_high: np.ndarray
    corners: bool
    segments: int = PIECES

    @property
    def rows(self) -> int:
        """The number of rows."""
        return 2 * self.segments + 1

    def nodes(self, t: int) -> np.ndarray:
        """The inventories at the end of day t: the points that divide all segments, and both ends
        of the interval."""
        low, high = self.next_low[t], self.next_high[t]
        if high <= low:
            return np.array([low])
        every = np.linspace(self.low[t], self.high[t], THIRD * self.segments + 1)
        near = 1e-6 * (self.high[t] - self.low[t])
        inside = every[(every > low + near) & (every < high - near)]
        return np.concatenate([[low], inside, [high]])

    def slopes(
        self, t: int, values: Callable[[np.ndarray], np.ndarray], low: float, high: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """[rows, …] the slopes above and below the rows, of `values` [n, …] that are known from low
        to high."""
        row = np.linspace(self.low[t], self.high[t], self.rows)
        part = (self.high[t] - self.low[t]) / (THIRD * self.segments)
        left = np.stack([row - part / 2, row - part / 2])
        if self.corners:
            left[:, ::2] = row[::2], row[::2] - part
        width = min(part, high - low)
        left = np.clip(left, low, high - width)
        above, below = ((values(item + width) - values(item)) / width for item in left)
        return above, below


def slope_table(schedule) -> SlopeTable:
    """The rows of all days: on the corners if these are known and few enough, otherwise across each
    interval."""
    steps = schedule.steps
    low, high = np.asarray(steps.next_low, float), np.asarray(steps.next_high, float)
    across = SlopeTable(low, high, low, high, corners=False)
    widest = np.max(high - low, initial=0.0)
    for segments, divisors in ((PIECES, DIVISORS), (2 * PIECES, FINE)):
        volume = common_volume(steps, divisors)
        if volume is None or widest <= 0:
            continue
        step = volume / max(1, int(segments * volume / (widest + volume) + COMMON))
        first = low[-1] + np.floor((low - low[-1]) / step + COMMON) * step
        last = first + segments * step
        if np.all(last >= high - COMMON * step):
            return SlopeTable(first, last, low, high, corners=True, segments=segments)
    return across


def common_volume(steps, divisors: int = DIVISORS) -> float | None:
    """The common divisor of all daily volumes; None if it is too small a part of the smallest
    volume, if the volumes depend on the inventory, or if gas is lost."""
    volumes = np.concatenate([steps.injection_rate, steps.withdrawal_rate])
    if np.any(np.ptp(volumes, axis=1) > 0) or np.any(np.asarray(steps.inventory_loss) != 0):
        return None
    volumes = np.unique(volumes[volumes > 0])
    for part in range(1, divisors + 1) if len(volumes) else ():
        volume = volumes[0] / part
        if np.all(np.abs(volumes - np.round(volumes / volume) * volume) <= COMMON * volume):
            return float(volume)
    return None


# Where the fast factor's nodes of the quick program lie, in standard deviations of a daily shock.
SPACING = 0.6
# The polynomial is fitted, and to be trusted, within this many standard deviations of the factor.
FITTED = 3.0
DEGREE = 4  # of it; with 2 a store of fast corners lost 0.3 % of its value, now 0.04 %


@dataclass(frozen=True, eq=False)
class MarginalValues:
    """The value of one more unit of gas at the END of each day, as a present value.

    - `low`, `high`: [T] the range of the table, see `SlopeTable`; row k of n is at low + k / (n -
      1) (high - low).
    - `above`, `below`: [T, rows, n] the coefficients c on either side of a row, in c0 + c1 f + c2
      f^2 + …, where f is the fastest factor on the day and the other factors are zero; currency per
      unit, discounted to the valuation date.
    - `reach`: [T] the largest |f| for which the polynomial was fitted; clip f to this range.
    """

    low: np.ndarray
    high: np.ndarray
    above: np.ndarray
    below: np.ndarray
    reach: np.ndarray


def marginal_values(
    schedule, factors: GaussianFactors | None, interpolation: Interpolation
) -> MarginalValues:
    """The table of a dynamic program in the fast factor, or of the intrinsic problem if there are
    no factors.

    If a day has only one possible inventory (`low` = `high`), the value is the spot price of the
    day. There must be at least one day.
    """
    table = slope_table(schedule)
    if factors is None:
        without_noise = _without_noise(schedule, interpolation, table)
        reach = np.zeros(len(schedule.steps.forward))
    else:
        grid = factor_grid(factors._replace(spikes=None), (factors.fast,), SPACING, 1)
        without_noise, reach = _with_noise(schedule, interpolation, table, grid), _reach(grid)
    above, below = without_noise
    return MarginalValues(table.low, table.high, above, below, reach)


def _with_noise(
    schedule, interpolation: Interpolation, table: SlopeTable, grid: FactorGrid
) -> np.ndarray:
    """[2, T, rows, n] above and below."""
    steps, constants = schedule.steps, schedule.constants
    horizon = len(steps.forward)
    polynomials, reach = np.zeros((2, horizon, table.rows, DEGREE + 1)), _reach(grid)
    volumes = free_volumes(schedule, interpolation)
    nodes = table.nodes(horizon - 1)
    value = end_value(schedule, nodes[:, None], grid.spot(horizon, constants.end_forward))
    for t in reversed(range(horizon)):
        after = grid.after(t).expect(value)
        spot = grid.spot(t, steps.forward[t])
        sides = np.zeros((2, table.rows, 1)) + steps.gas_discount[t] * spot
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
    slopes = np.zeros((2, len(steps.forward), table.rows, DEGREE + 1))
    for t, line in enumerate(values_after(schedule, interpolation, low, high)):
        slopes[:, t, :, 0] = steps.gas_discount[t] * steps.forward[t]
        if high[t + 1] > low[t + 1]:
            slopes[:, t, :, 0] = table.slopes(t, line, low[t + 1], high[t + 1])
    return slopes


def _interpolated(nodes: np.ndarray, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    return interpolation_matrix(nodes, points) @ values


def _reach(grid: FactorGrid) -> np.ndarray:
    """[T] three standard deviations of the factor on the day, or three times half of its largest
    standard deviation if that is more."""
    deviation = np.sqrt(grid.covariance[:-1, 0, 0])
    return FITTED * np.maximum(deviation, 0.5 * deviation.max(initial=0.0))


def _polynomial(states: np.ndarray, deviation: float, values: np.ndarray) -> np.ndarray:
    """The least-squares fit of values [rows, columns] to powers of f, weighted with the density of
    the factor."""
    polynomial = np.zeros((len(values), DEGREE + 1))
    if len(states) <= DEGREE or deviation == 0:
        polynomial[:, 0] = values[:, len(states) // 2]
        return polynomial
    unit = states / deviation
    weight = np.where(np.abs(unit) <= FITTED, np.exp(-(unit**2) / 4), 0.0)
    design = weight[:, None] * unit[:, None] ** np.arange(DEGREE + 1)
    solved = np.linalg.lstsq(design, (weight * values).T, rcond=None)[0].T
    return solved / deviation ** np.arange(DEGREE + 1)
