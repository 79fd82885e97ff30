"""Tables of the fitted value for one path: the value of a unit of each volume, and the control
variate.

They are filled while the value is fitted, step by step from the end, so that only the coefficients
of two steps are in memory. All coefficients of an hourly year would take 0.5 GB.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse

from ...gas_storage.bounds.regression import AnyBasis, Regression, regression_of
from ...gas_storage.policy.value_table import Reading
from ...gas_storage.prices.process import GaussianFactors
from ..core.contract import ContractLayout
from ..core.tables import LevelRows, Surprise, Surprises, UnitValues, UnitValueTable, Values
from .fitted import backwards
from .grid import ContractGrid, StepGrid

MOST_ROWS = 401  # of the value of a level
NEAR = 1e-6  # of a unit: rounding makes no part of it
FURTHER = 1.5  # rows: a volume no longer than that is of one row
SURPRISES = {0: 1, 1: 25, 2: 7, 3: 4}  # rows of a level for the control variate, by their number


class ValueTables(NamedTuple):
    """The unit values from which a policy starts; and the control variate, None if prices have
    risks other than the factors of the fit."""

    unit_values: UnitValueTable
    surprises: Surprises | None


def value_tables(
    layout: ContractLayout,
    schedule: Any,
    factors: GaussianFactors,
    basis: AnyBasis,
    grid: ContractGrid,
    like: UnitValues | None = None,
) -> ValueTables:
    """The tables of the fitted value of a schedule with NumPy leaves and at least one step.

    If the best volumes lie on rows, a policy searches for the last profitable row, otherwise for
    the last piece between rows; if the value jumps, it compares all rows. `like`: a table of other
    inputs; the policy searches in the same way as with that table, on any grid.
    """
    terms, search = schedule.steps.terms, "units" if grid.exact else "between"
    if terms.jumps:
        search = "every"
    elif like is not None:
        search = next((x for x in ("units", "between") if getattr(like, x) is not None), "")
    compared = 0 if like is None or like.every is None else like.every.shape[-1]
    units = _UnitRows(layout, basis, grid, np.asarray(terms.most), search, compared)
    surprises = _SurpriseRows(layout, basis, grid) if factors.exact else None
    later = np.zeros(0)
    for t, coefficients in backwards(layout, schedule, factors, grid):
        if t < len(grid.steps):
            units.add(t, later)
        if surprises is not None:
            surprises.add(t, coefficients)
        later = coefficients
    return ValueTables(units.table(), None if surprises is None else surprises.table())


class _UnitRows:
    """The value of a unit of each volume after each step, and of each move."""

    def __init__(
        self,
        layout: ContractLayout,
        basis: AnyBasis,
        grid: ContractGrid,
        largest: np.ndarray,
        search: str,
        compared: int,
    ):
        self.layout, self.basis, self.grid, self.largest = layout, basis, grid, largest
        self.search = search  # the field of `UnitValues` with its rows; "" for none
        self.compared = compared  # rows of a table of other inputs, which is compiled already
        self.available, self.counts = regression_of(basis), _row_counts(layout, grid)
        horizon = len(grid.steps)
        self.low, self.spacing = np.zeros((2, horizon, len(layout.levels)))
        self.slopes: np.ndarray | None = None  # [T, pairs, rows …, n]
        self.moves: np.ndarray | None = None  # [T, moves, rows …, n]
        self.by_nodes: dict[tuple, _StepWeights] = {}  # steps with the same nodes have the same
        self.flow_moves = [layout.every_move[m] for m, _ in layout.pairs]

    def add(self, t: int, later: np.ndarray) -> None:
        """Adds a step, from the coefficients at the start of the next step."""
        layout, step = self.layout, self.grid.steps[t]
        after = self._after(t, later)
        key = tuple(x.tobytes() for x in step.after)
        if key not in self.by_nodes:
            self.by_nodes[key] = _step_weights(layout, self.grid.layout, step, self.counts)
        weights = self.by_nodes[key]
        self.low[t], self.spacing[t] = weights.rows
        if self.slopes is None:
            shape = len(self.low), len(layout.pairs), *self.counts, after.shape[-1]
            self.slopes = np.zeros(shape)
            self.moves = np.zeros((shape[0], len(layout.moves), *shape[2:]))
        for k, (of, move) in enumerate(zip(weights.slopes, self.flow_moves)):
            self.slopes[t, k] = (of @ after[move.after]).reshape(self.slopes.shape[2:])
        if layout.moves and self.moves is not None:
            values = [of @ after[move.after] for of, move in zip(weights.moves, layout.moves)]
            before = [move.before for move in layout.moves]
            relative = [x - values[before.index(mode)] for x, mode in zip(values, before)]
            self.moves[t] = np.reshape(relative, self.moves.shape[1:])

    def table(self) -> UnitValueTable:
        """The table of all steps."""
        reading = Reading(*(x[: len(self.low)] for x in self.basis.linear()))  # pyright: ignore
        moves = self.moves if self.layout.moves else None
        rows = LevelRows(self.low, self.spacing)  # pyright: ignore
        table = UnitValues(rows, self.slopes, moves, reading)  # pyright: ignore
        return UnitValueTable(
            table._replace(**({self.search: self._units()} if self.search else {}))
        )

    def _units(self) -> np.ndarray | None:
        """[T, pairs, searches, or rows where all are compared] the volume of a row along each flow.
        None if no volume spans more than one row, or if the rows of levels that a flow joins have
        different volumes."""
        result = np.ones((len(self.low), len(self.layout.pairs)))
        longest, crossings = 0.0, 0
        for k, (_, f) in enumerate(self.layout.pairs):
            effects = np.abs(self.layout.flows[f].effects)
            touched = np.flatnonzero(effects)
            rows = self.spacing[:, touched] / effects[touched]
            smallest = np.where(rows > 0, rows, np.inf).min(axis=1, initial=np.inf)
            if np.any(rows > (1 + 1e-6) * smallest[:, None]):
                return None
            several = 1
            if self.search == "between":  # see `FlowRows`
                several = len(touched) if len(touched) > 1 else len(effects)
            longest = max(longest, float(np.max(self.largest[:, f] / smallest, initial=0.0)))
            crossings = max(crossings, several * math.ceil(longest))
            result[:, k] = np.where(np.isfinite(smallest), smallest, 1.0)
        if longest <= FURTHER:
            return None
        searches = (crossings + 1).bit_length()  # a volume begins and ends within rows
        if self.search == "every":
            searches = max(crossings + 1, self.compared or crossings + 2)
        return np.repeat(result[:, :, None], searches, axis=2)

    def _after(self, t: int, later: np.ndarray) -> np.ndarray:
        """[modes, nodes after, n] coefficients after a step, as expected before the next one.

        If there is a choice of moves, the functions include the hinges: with polynomials only, a
        contract with few rights would lose 0.5 to 0.8 % of its value. For volumes the hinges gain
        nothing, and take three times as long.
        """
        end, available, constant = self.grid.steps[t].end, self.available, self.basis.constant
        if self.layout.moves and isinstance(available, Regression):
            day, constant = available.day(t), -1 if available.basis.common else constant
            moved = day.ahead @ day.fit.T
        else:
            moved = available.drift(t)
        result, money = end.settled(later @ moved), end.money
        if money is not None:
            result[:, :, constant] += money
        return result


class _SurpriseRows:
    """The control variate: the value on a few rows, and the expectation of the value a step
    before."""

    def __init__(self, layout: ContractLayout, basis: AnyBasis, grid: ContractGrid):
        self.basis, self.grid, self.available = basis, grid, regression_of(basis)
        dates, self.counts = len(grid.nodes), (SURPRISES[len(layout.levels)],) * len(layout.levels)
        self.low, self.spacing = np.zeros((2, dates, len(layout.levels)))
        self.values = np.zeros((dates, len(layout.modes), math.prod(self.counts), basis.plain))
        self.by_nodes: dict[tuple, sparse.csr_array] = {}

    def add(self, t: int, coefficients: np.ndarray) -> None:
        """Adds a date, from its coefficients."""
        nodes = self.grid.nodes[t]
        for i, (x, count) in enumerate(zip(nodes, self.counts)):
            self.low[t, i], self.spacing[t, i] = x[0], (x[-1] - x[0]) / (count - 1)
        key = tuple(x.tobytes() for x in nodes)
        if key not in self.by_nodes:
            rows = self.low[t] + self.spacing[t] * _numbers(self.counts)
            self.by_nodes[key] = _between(nodes, rows)
        for k, mode in enumerate(coefficients @ self.available.plain(t)):
            self.values[t, k] = self.by_nodes[key] @ mode

    def table(self) -> Surprises:
        """The table of all dates."""
        values, basis = self.values, self.basis
        dates, modes, _, size = values.shape
        flat = values.reshape(dates, -1, size)
        ahead = basis.expected_coefficients(flat[1:]).reshape(values[1:].shape)
        shape = (dates, modes, *self.counts, size)
        values, ahead = values.reshape(shape), ahead.reshape(dates - 1, *shape[1:])
        low, spacing = self.low, self.spacing
        reading = Reading(*(x[:-1] for x in basis.linear()))  # pyright: ignore
        rows = [LevelRows(low[:-1], spacing[:-1]), LevelRows(low[1:], spacing[1:])]  # pyright: ignore
        table = Surprise(Values(rows[0], values[:-1]), Values(rows[1], ahead), reading)  # pyright: ignore
        start = values[0].reshape(modes, -1, size)[0, 0]
        return Surprises(table, np.asarray(start @ basis.plain_first))


def _row_counts(layout: ContractLayout, grid: ContractGrid) -> tuple[int, ...]:
    counts = []
    for i in range(len(layout.levels)):
        every = {x.after[i].tobytes(): x.after[i] for x in grid.steps}.values()
        widths = [(*_lattice(nodes), nodes[-1]) for nodes in every]
        finest = [(high - low) / width for low, width, high in widths if width > 0]
        counts.append(int(min(math.ceil(max(finest, default=1.0) - 1e-6) + 1, MOST_ROWS)))
    return tuple(counts)


def _rows(step: StepGrid, counts) -> tuple[np.ndarray, np.ndarray]:
    """`low` and `spacing` of the rows of each level; the rows are its nodes if there are few enough
    of these."""
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
    """The first point and the spacing of evenly spaced points that contain the nodes; the first and
    the last node may be nearer to their neighbours. For other nodes, the first node and the finest
    spacing."""
    if len(nodes) < 2:
        return float(nodes[0]), 0.0
    gaps = np.diff(nodes)
    inner = gaps[1:-1] if len(gaps) > 2 else gaps[-1:]
    width, even = float(inner.max()), np.ptp(inner) < 1e-6 * inner[0]
    if even and np.all(gaps < (1 + 1e-6) * width):
        inner = nodes[1] / width
        if len(nodes) > 2 and abs(inner - round(inner)) > 1e-6:  # not multiples of the width
            return float(nodes[1] - np.ceil(gaps[0] / width - 1e-6) * width), width
        return float(np.floor(nodes[0] / width + 1e-6) * width), width
    return float(nodes[0]), float(gaps.min())


class _StepWeights(NamedTuple):
    """`rows`: low and spacing of the rows of a step. `slopes`, `moves`: the weights [rows, nodes]
    of the values at the nodes after the step, in the slope of each pair of a move and a flow, and
    in the value after each move."""

    rows: tuple[np.ndarray, np.ndarray]
    slopes: list[sparse.csr_array]
    moves: list[sparse.csr_array]


def _step_weights(
    layout: ContractLayout, on_grid: ContractLayout, step: StepGrid, counts
) -> _StepWeights:
    low, spacing = _rows(step, counts)
    rows = low + spacing * _numbers(counts)
    slopes = [_slope(on_grid, step, rows, spacing, f) for _, f in layout.pairs]
    moves = [_between(step.after, rows + np.array(move.changes)) for move in on_grid.moves]
    return _StepWeights((low, spacing), slopes, moves)


def _slope(layout: ContractLayout, step: StepGrid, rows, spacing, f: int) -> sparse.csr_array:
    """The weights of the nodes in the change of the value by one more unit along a flow, from each
    row."""
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
    # A unit that only partly lies between the limits has the slope of that part.
    start, end = _inside(rows, unit * effects, low, high)
    part = end - start
    partial = (part > NEAR) & (part < 1 - NEAR)
    if partial.any():
        limits = (rows[partial] + x[partial, None] * unit * effects for x in (start, end))
        first[partial], last[partial] = (np.clip(x, low, high) for x in limits)
    slopes = (_between(step.after, last) - _between(step.after, first)) / unit
    if not partial.any():
        return slopes
    return sparse.csr_array(sparse.diags_array(1 / np.where(partial, part, 1.0)) @ slopes)


def _inside(rows: np.ndarray, change: np.ndarray, low, high) -> tuple[np.ndarray, np.ndarray]:
    """[n] the interval of shares of a change of the levels, from each of these rows, for which the
    levels lie between the limits. If there is no such share, the end of the interval is below its
    start."""
    start, end = np.zeros(len(rows)), np.ones(len(rows))
    for x, step, lower, upper in zip(rows.T, change, low, high):
        if step:
            sides = np.sort([(lower - x) / step, (upper - x) / step], axis=0)
            start, end = np.maximum(start, sides[0]), np.minimum(end, sides[1])
    return start, end


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
