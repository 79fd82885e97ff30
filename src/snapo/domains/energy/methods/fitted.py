"""The fitted value: least squares of the value of the best move on functions of the price factors.

Backwards in time, on nodes of the levels and quadrature nodes of the factors. The expectation of
the functions a step later is known in closed form, so that only the fit is an approximation
(Tsitsiklis and Van Roy, IEEE Transactions on Neural Networks 12, 2001). From it come the values of
a unit of each level and of each mode for the policy, the control variate, and the penalty of the
upper bound.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse

from ...gas_storage.bounds.regression import (
    AnyBasis,
    AnyRegression,
    Regression,
    basis_of,
    regression_of,
)
from ...gas_storage.policy.guide import Reading
from ...gas_storage.prices.process import GaussianFactors
from ..core.contract import ContractLayout, StepPrices
from ..core.tables import LevelRows, Surprise, Surprises, UnitValues, UnitValueTable, Values
from .grid import ContractGrid, StepGrid, arrived, best, node_levels

MOST_ROWS = 401  # of the value of a level
SURPRISES = {0: 1, 1: 25, 2: 7, 3: 4}  # rows of a level for the control variate, by their number


@dataclass(frozen=True, eq=False)
class FittedContract:
    """The value at the start of each of T steps, and after the last.

    - `coefficients`: T + 1 arrays [modes, nodes, K] of the functions of `basis`.
    - `value`: today's; an approximation.
    """

    basis: AnyBasis
    grid: ContractGrid
    coefficients: list[np.ndarray]
    value: float

    @property
    def available(self) -> AnyRegression:
        """The regression that it is the result of."""
        return regression_of(self.basis)


def fit(
    layout: ContractLayout, schedule: Any, factors: GaussianFactors, grid: ContractGrid
) -> FittedContract:
    """The fitted value of a schedule with NumPy leaves, which has a step."""
    terms, horizon = schedule.steps.terms, len(grid.steps)
    basis = basis_of(factors, priced=False)
    available, size = regression_of(basis), basis.size
    coefficients = _room([(len(layout.modes), grid.size(t), size) for t in range(horizon + 1)])
    coefficients[horizon][:] = 0.0
    for t in reversed(range(horizon)):
        step, later = grid.steps[t], coefficients[t + 1]
        value = available.expected(t, later.reshape(-1, size))
        after = arrived(step, value.reshape(*later.shape[:2], -1))
        prices = StepPrices(
            available.spot(t, schedule.steps.forward[t]), _index(available, factors, t)
        )
        value = best(step, layout, prices.units(terms, t), prices.moves(terms, t), after)
        flat = np.where(np.isfinite(value), value, 0.0).reshape(-1, value.shape[2])
        coefficients[t][:] = available.fitted(t, flat).reshape(*value.shape[:2], size)
    return FittedContract(basis, grid, coefficients, float(coefficients[0][0, 0] @ basis.first))


def _room(shapes: list[tuple[int, ...]]) -> list[np.ndarray]:
    """Arrays of these shapes in one: the system regains its memory, not that of many small ones."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    parts = np.split(np.empty(ends[-1]), ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes)]


def _index(available: AnyRegression, factors: GaussianFactors, t: int) -> np.ndarray | None:
    """[Q] the index on the nodes, whose last factor is its own."""
    if factors.index is None or not isinstance(available, Regression):
        return None
    return factors.index.price(factors, t, (available.basis.back(t) @ available.y)[-1])


def unit_value_table(layout: ContractLayout, fitted: FittedContract) -> UnitValueTable:
    """The value of a unit of each volume after each step, and of each move."""
    horizon, basis = len(fitted.grid.steps), fitted.basis
    counts = _row_counts(layout, fitted.grid)
    lows, spacings, moves = [], [], []
    slopes = np.zeros(0)  # [T, pairs, rows …, n]
    cache: dict[tuple, _StepWeights] = {}  # steps with the same nodes have the same
    for t in range(horizon):
        step = fitted.grid.steps[t]
        low, spacing = _rows(step, counts)
        after = _after(layout, fitted, t)
        key = tuple(x.tobytes() for x in (low, spacing, *step.after))
        if key not in cache:
            rows = low + spacing * _numbers(counts)
            cache[key] = _step_weights(layout, step, rows, spacing)
        weights = cache[key]
        local = [
            x @ after[layout.every_move[m].after] for x, (m, _) in zip(weights.slopes, layout.pairs)
        ]
        if not t:
            slopes = np.empty((horizon, len(local), *counts, after.shape[-1]))
        slopes[t] = np.reshape(local, slopes.shape[1:])
        if layout.moves:
            values = [x @ after[move.after] for x, move in zip(weights.moves, layout.moves)]
            before = [move.before for move in layout.moves]
            relative = [x - values[before.index(mode)] for x, mode in zip(values, before)]
            moves.append(np.stack(relative).reshape(len(relative), *counts, -1))
        lows.append(low)
        spacings.append(spacing)
    place = LevelRows(np.stack(lows), np.stack(spacings))  # pyright: ignore
    reading = Reading(*(x[:horizon] for x in basis.linear()))  # pyright: ignore
    table = UnitValues(place, slopes, np.stack(moves) if moves else None, reading)  # pyright: ignore
    return UnitValueTable(table)


def _after(layout: ContractLayout, fitted: FittedContract, t: int) -> np.ndarray:
    """[modes, nodes after, n] coefficients after a step, as expected before the next one.

    Where there is a choice of moves, with the hinges: polynomials without them lose 0.5 to 0.8 %
    of a few rights. For volumes they gain nothing, and take three times as long.
    """
    step, later = fitted.grid.steps[t], fitted.coefficients[t + 1]
    available, constant = fitted.available, fitted.basis.constant
    if layout.moves and isinstance(available, Regression):
        day, constant = available.day(t), -1 if available.basis.common else constant
        moved = day.ahead @ day.fit.T
    else:
        moved = available.drift(t)
    result, money = step.end.settled(later @ moved), step.end.money
    if money is not None:
        result[:, :, constant] += money
    return result


def _row_counts(layout: ContractLayout, grid: ContractGrid) -> tuple[int, ...]:
    counts = []
    for i in range(len(layout.levels)):
        widths = [(*_lattice(x.after[i]), x.after[i][-1]) for x in grid.steps]
        finest = [(high - low) / width for low, width, high in widths if width > 0]
        counts.append(int(min(math.ceil(max(finest, default=1.0) - 1e-6) + 1, MOST_ROWS)))
    return tuple(counts)


def _rows(step: StepGrid, counts) -> tuple[np.ndarray, np.ndarray]:
    """`low` and `spacing` of the rows of each level: on its nodes where these are few enough."""
    low, spacing = np.zeros(len(counts)), np.zeros(len(counts))
    for i, (nodes, count) in enumerate(zip(step.after, counts)):
        low[i], spacing[i] = _lattice(nodes)
        if low[i] + (count - 1) * spacing[i] < nodes[-1] - 1e-6 * spacing[i]:
            low[i], spacing[i] = nodes[0], np.ptp(nodes) / (count - 1)
    return low, spacing


def _numbers(counts: tuple[int, ...]) -> np.ndarray:
    """[rows, levels] the numbers of all rows: one row without levels."""
    if not counts:
        return np.zeros((1, 0))
    return np.indices(counts).reshape(len(counts), -1).T


def _lattice(nodes: np.ndarray) -> tuple[float, float]:
    """The first point at or before the nodes, and the spacing, of the evenly spaced points that
    they are; the first and the last node may lie nearer. Of other nodes the finest spacing."""
    if len(nodes) < 2:
        return float(nodes[0]), 0.0
    gaps = np.diff(nodes)
    inner = gaps[1:-1] if len(gaps) > 2 else gaps[-1:]
    width, even = float(inner.max()), np.ptp(inner) < 1e-6 * inner[0]
    if even and np.all(gaps < (1 + 1e-6) * width):
        return float(np.floor(nodes[0] / width + 1e-6) * width), width
    return float(nodes[0]), float(gaps.min())


class _StepWeights(NamedTuple):
    """Of the values of the nodes after a step, [rows, nodes] each: in the slope of each pair of a
    move and a flow, and in the value after each move."""

    slopes: list[sparse.csr_array]
    moves: list[sparse.csr_array]


def _step_weights(layout: ContractLayout, step: StepGrid, rows, spacing) -> _StepWeights:
    slopes = [_slope(layout, step, rows, spacing, f) for _, f in layout.pairs]
    moves = [_between(step.after, rows + np.array(move.changes)) for move in layout.moves]
    return _StepWeights(slopes, moves)


def _slope(layout: ContractLayout, step: StepGrid, rows, spacing, f: int) -> sparse.csr_array:
    """The weights of the change of the value by one more unit along a flow from each row."""
    effects = np.array(layout.flows[f].effects)
    touched = np.flatnonzero((effects != 0) & (spacing > 0)) if len(effects) else []
    if not len(touched):
        return sparse.csr_array((len(rows), math.prod(map(len, step.after))))
    unit = min(spacing[i] / abs(effects[i]) for i in touched)
    low, high = (np.array([x[k] for x in step.after]) for k in (0, -1))
    first = np.clip(rows, low, high)
    last = first + unit * effects
    # At the limits the slope is that of the last unit before them.
    back = np.maximum(np.maximum(last - high, 0), np.maximum(low - last, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(effects != 0, back / np.abs(unit * effects), 0.0).max(axis=1)
    share = np.minimum(share, 1.0)[:, None]
    first, last = first - share * unit * effects, last - share * unit * effects
    first, last = np.clip(first, low, high), np.clip(last, low, high)
    return (_between(step.after, last) - _between(step.after, first)) / unit


def _between(nodes, points: np.ndarray) -> sparse.csr_array:
    """[n, nodes] weights of nodes at points [n, levels]: linear between nodes, flat beyond."""
    count, sizes = len(points), [len(x) for x in nodes]
    lefts, shares = [], []
    for i, x in enumerate(nodes):
        position = np.interp(points[:, i], x, np.arange(len(x), dtype=float))
        left = np.minimum(position.astype(int), max(len(x) - 2, 0))
        lefts.append(left)
        shares.append(position - left)
    entries, columns = [], []
    for corner in range(2 ** len(sizes)):
        weight, node = np.ones(count), np.zeros(count, int)
        for i, size in enumerate(sizes):
            up = (corner >> i) & 1
            weight = weight * (shares[i] if up else 1 - shares[i])
            node = node * size + np.minimum(lefts[i] + up, size - 1)
        if weight.any():  # few corners, where points are nodes
            entries.append(weight)
            columns.append(node)
    rows = np.tile(np.arange(count), len(entries))
    numbers = np.concatenate(entries), (rows, np.concatenate(columns))
    return sparse.csr_array(sparse.coo_array(numbers, shape=(count, math.prod(sizes))))


def surprises(layout: ContractLayout, fitted: FittedContract) -> Surprises:
    """The control variate: the value on a few rows, and its expectation a step before."""
    basis, grid, available = fitted.basis, fitted.grid, fitted.available
    dates, count = len(grid.nodes), SURPRISES[len(layout.levels)]
    counts = (count,) * len(layout.levels)
    lows, spacings, now = [], [], []
    cache: dict[tuple, sparse.csr_array] = {}
    for t in range(dates):
        nodes = grid.nodes[t]
        low = np.array([x[0] for x in nodes])
        spacing = np.array([np.ptp(x) / (count - 1) for x in nodes]) if nodes else np.zeros(0)
        rows = low + spacing * _numbers(counts)
        plain = fitted.coefficients[t] @ available.plain(t)
        key = tuple(x.tobytes() for x in nodes)
        if key not in cache:
            cache[key] = _between(nodes, rows)
        now.append(np.stack([cache[key] @ mode for mode in plain]))
        lows.append(low)
        spacings.append(spacing)
    values = np.stack(now)  # [T + 1, modes, rows, n]
    flat = values.reshape(dates, -1, values.shape[-1])
    ahead = basis.expected_coefficients(flat[1:]).reshape(values[1:].shape)
    shape = (dates, len(layout.modes), *counts, values.shape[-1])
    values, ahead = values.reshape(shape), ahead.reshape(dates - 1, *shape[1:])
    low, spacing = np.stack(lows), np.stack(spacings)
    reading = Reading(*(x[:-1] for x in basis.linear()))  # pyright: ignore
    rows = [LevelRows(low[:-1], spacing[:-1]), LevelRows(low[1:], spacing[1:])]  # pyright: ignore
    table = Surprise(Values(rows[0], values[:-1]), Values(rows[1], ahead), reading)  # pyright: ignore
    start = values[0].reshape(len(layout.modes), -1, values.shape[-1])[0, 0]
    return Surprises(table, np.asarray(start @ basis.plain_first))


def levels_of(fitted: FittedContract, t: int) -> np.ndarray:
    """[nodes, levels] at the start of a step."""
    return node_levels(fitted.grid.nodes[t])
