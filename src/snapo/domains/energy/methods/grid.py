"""Nodes of the levels of a contract, and all moves from the nodes of a step to the next nodes.

Values are linear between nodes. If flows, limits and starts have a common measure, nodes are its
multiples, and all volumes that a best decision can take lead from node to node: values there are
exact, neither raised nor lowered. If a single level has no practical measure, its nodes are its
breakpoints: all levels to which the largest and smallest flows lead from the start and from the
limits, forwards and backwards. If there are too many breakpoints, the nodes are evenly spaced, and
values between them are interpolated linearly. `exact` is then false: the values are approximate,
and not a bound.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError

from ..core.contract import ContractLayout
from .idle import at_rest, extremes, idle_levels, with_idle, without
from .measure import banked_widths, measures_of, node_widths
from .passages import Passages, passages_of
from .settling import Settling, ranges_of_balances, settling
from .ways import StepWays

MOST = 1200  # nodes of a level
TOGETHER = 20_000  # of all levels
COARSE = {0: 1, 1: 401, 2: 2601, 3: 4913}  # where these are too many, by the number of levels
MOVED = 1.5  # times as many for a moved contract, whose nodes are as far apart as before
LONG = 2_000_000  # nodes of all steps of a coarse grid
NEAR = 1e-9  # of the largest volume: nearer levels are one


class StepGrid(NamedTuple):
    """One step: the passages of each move, and the nodes `before` and `after` the step, with an
    array for each level.

    - `end`: the changes at the end of the step; `ways`: the passages in the form that machine code
      needs, or None.
    """

    passages: Passages
    before: tuple[np.ndarray, ...]
    after: tuple[np.ndarray, ...]
    end: Settling
    ways: StepWays | None = None


@dataclass(frozen=True, eq=False)
class ContractGrid:
    """All steps of a contract with NumPy numbers. In `layout` nothing moves an idle level.

    `exact`: whether best decisions lead from node to node, see above.
    """

    layout: ContractLayout
    steps: list[StepGrid]
    last: tuple[np.ndarray, ...]
    exact: bool

    @cached_property
    def nodes(self) -> list[tuple[np.ndarray, ...]]:
        """[T + 1] the nodes at the start of each step, and after the last one."""
        return [step.before for step in self.steps] + [self.last]

    def size(self, t: int) -> int:
        """The number of nodes at the start of a step."""
        return int(np.prod([len(x) for x in self.nodes[t]], dtype=int))


def grid_of(
    layout: ContractLayout, schedule: Any, parts: int = 1, apart: np.ndarray | None = None
) -> ContractGrid:
    """The grid of a schedule with NumPy leaves.

    - `parts`: the number of parts into which the common divisor of the volumes (the distance of
      nodes) is divided, for a finer grid.
    - `apart` [levels]: the smallest distance of nodes, for a coarse grid.
    """
    terms, found = schedule.steps.terms, schedule.steps.intervals
    start = np.asarray(schedule.constants.start, float)
    idle = idle_levels(layout, terms, found, start)
    before, after, exact = _nodes(layout, terms, found, start, parts, apart, idle)
    layout = at_rest(layout, idle)
    scale = max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    by_volumes: dict[tuple, tuple] = {}
    steps = []
    for t in range(len(after)):
        numbers = [terms.least[t], terms.most[t], *before[t], *after[t]]
        numbers += [] if terms.fixed_volume is None else [terms.fixed_volume[t]]
        numbers += [x[t] for x in (*(terms.of_moves or ()), *(terms.falling or ()))]
        key = tuple(np.asarray(x).tobytes() for x in numbers)
        if key not in by_volumes:
            passages = passages_of(layout, terms, t, before[t], after[t], NEAR * scale)
            sizes = [[len(x) for x in nodes] for nodes in (before[t], after[t])]
            by_volumes[key] = passages, StepWays(layout, passages, *sizes)
        end = settling(layout, terms, t, before[t], after[t], before[t + 1])
        passages, ways = by_volumes[key]
        steps.append(StepGrid(passages, before[t], after[t], end, ways))
    return ContractGrid(layout, steps, before[-1], exact)


def check_nodes(case: Any, schedule: Any) -> None:
    """Refuses limits of moves and joint limits that would lie between coarse nodes; `schedule`:
    with NumPy leaves.

    **Raises:** `CaseError` if volumes have no common divisor with few enough nodes.
    """
    layout = case.contract.layout
    start, limited = np.asarray(schedule.constants.start, float), schedule.steps.terms.jumps
    if not (layout.sums or limited):
        return
    terms, intervals = schedule.steps.terms, schedule.steps.intervals
    idle = idle_levels(layout, terms, intervals, start)
    if _nodes(layout, terms, intervals, start, 1, None, idle)[2]:
        return
    measure = measures_of(layout, terms, start)[0]
    divisor = "there is none" if measure is None else f"it is {measure:.6g} {case.volume_unit}"
    count = int(_combinations(len(case.days)))
    message = (
        f"{_VOLUMES[limited]} need a larger common divisor: {divisor}, and the methods allow at "
        f"most about {count:,} combinations of levels {_LEVELS[limited]} that are multiples of it"
    )
    raise CaseError(str(case.file), "contract", None, message)


def _combinations(horizon: int) -> float:
    """The largest number of nodes, combinations of levels, that the methods allow with so many
    steps."""
    return min(TOGETHER, 2 * LONG / max(horizon, 1))


_VOLUMES = {False: "inventories, limits and rates", True: "levels, limits of moves and flows"}
_LEVELS = {False: "of both stores and of the joint flow", True: "between which the value jumps"}


def best(
    step: StepGrid, layout: ContractLayout, cash: np.ndarray, fixed: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """[modes, nodes, columns] the value of the best move and volume from each node. `cash` [flows,
    columns]: earnings of a unit; `fixed` [moves] or [moves, columns]: amounts of the moves;
    `after` [modes, nodes after, columns]: the value after the step. Columns are nodes of price
    factors, or paths.
    """
    shape, goal_shape = ([len(x) for x in nodes] for nodes in (step.before, step.after))
    columns = after.shape[2]
    if step.ways is not None and step.ways.serve(columns):
        return _completed(step, step.ways.best(cash, fixed, after))
    value = np.full((len(layout.modes), math.prod(shape), columns), -np.inf)
    room = np.empty(value[0].size)  # of one passage: new memory for each would take longer
    for move, passages, money in zip(layout.every_move, step.passages, fixed):
        here, there = value[move.before], after[move.after]
        block, goal_block = here.reshape(*shape, columns), there.reshape(*goal_shape, columns)
        for flow, volume, rows, goals, weights in passages:
            earned = money + volume * cash[flow] if flow >= 0 and volume else money
            if weights is None:
                highest, source = block[rows], goal_block[goals]
                reached = room[: source.size].reshape(source.shape)
                np.maximum(highest, np.add(source, earned, out=reached), out=highest)
            else:
                reached = weights[0] * there[goals[0]]
                for weight, goal in zip(weights[1:], goals[1:]):
                    reached += weight * there[goal]
                reached += earned
                here[rows] = np.maximum(here[rows], reached)
    return _completed(step, value)


def _completed(step: StepGrid, value: np.ndarray) -> np.ndarray:
    """The value of the best move, minus the money of the levels at the start of the step.

    With joint limits, a node from which no move keeps the limits gets the value of the worst node.
    """
    if step.end.missed is not None and not (possible := np.isfinite(value)).all():
        worst = np.where(possible, value, np.inf).min(axis=(0, 1))
        value = np.where(possible, value, worst)
    return value if step.end.held is None else value - step.end.held[0][:, None]


def arrived(step: StepGrid, value: np.ndarray) -> np.ndarray:
    """[modes, nodes after, columns] the value after the moves of a step, from the value at the
    start of the next step; settling lies between the two."""
    result, money = step.end.settled(value), step.end.money
    return result if money is None else result + money[..., None]


def _nodes(layout: ContractLayout, terms, found, start, parts: int, apart: np.ndarray | None, idle):
    """The nodes of each level at the start of each step [T + 1] and after each step [T]; and
    whether they are exact."""
    every, horizon = (start, terms.restarts, idle), len(terms.low)
    others = ~np.array(idle, bool)
    start, apart = start[others], None if apart is None else apart[others]
    layout, terms, found = without(layout, terms, found, idle)
    count = len(layout.levels)
    measures = measures_of(layout, terms, start)
    counted = count - layout.banks
    visited = [_visited(layout, terms, found, start, i) for i in range(counted)]
    if layout.banks:
        visited += ranges_of_balances(terms, start[counted:], *visited[0])
    widest = [float(np.max(high - low)) for low, high in visited]
    coarse, limit = min(COARSE[min(count, 3)], LONG / max(horizon, 1)), _combinations(horizon)
    least = np.zeros(count) if apart is None else apart
    if least.any():
        coarse = MOVED * (limit if terms.jumps else coarse)
    if layout.banks:
        widths = banked_widths(visited, measures, least, LONG)
    else:
        widths = node_widths(layout, widest, measures, least, coarse)
    sizes = [w / m if m else np.inf for w, m in zip(widest, measures)]
    together = math.prod(x + 1 for x in sizes)
    exact = all(x <= MOST for x in sizes) and together <= limit
    if apart is not None and (least.any() or not terms.jumps):
        exact = exact and all(m > (1 - NEAR) * w for m, w in zip(measures, widths) if m)
    columns = []
    for i, (low, high) in enumerate(visited):
        restarts, measure = terms.restarts[:, i], measures[i]
        if i >= counted:  # a balance, which no flow moves
            width = measure if exact and measure is not None else widths[i]
            of_steps = _regular(low, high, width / parts, restarts, None if exact else 0.0)[0]
            columns.append((of_steps, of_steps[:-1]))
            continue
        if layout.banks and measure is not None and widths[i] <= measure * (1 + NEAR):
            columns.append(_regular(low, high, measure, restarts))
            continue
        if exact and measure is not None:
            columns.append(_regular(low, high, measure / parts, restarts))
            continue
        uneven = count == 1 and not terms.jumps  # jumps need rows on all nodes
        points = _breakpoints(layout, terms, start, i, low, high) if uneven else None
        if points is None:
            points = _regular(low, high, widths[i] / parts, restarts, _origin(layout, terms, i))
        else:
            exact = True
        columns.append(points)
    columns = with_idle(columns, *every)
    before = [tuple(c[0][t] for c in columns) for t in range(horizon + 1)]
    after = [tuple(c[1][t] for c in columns) for t in range(horizon)]
    return before, after, exact


def _visited(layout, terms, found, start, i) -> tuple[np.ndarray, np.ndarray]:
    """The range [T + 1] of a level that is reachable and feasible: today, and after each step
    before settling."""
    horizon = len(terms.low)
    low, high = np.empty(horizon + 1), np.empty(horizon + 1)
    low[0] = high[0] = first = last = start[i]
    for t in range(horizon):
        change = extremes(layout, terms, t, i)
        low[t + 1] = min(max(first + change.min(), found.next_low[t, i]), found.next_high[t, i])
        high[t + 1] = max(min(last + change.max(), found.next_high[t, i]), low[t + 1])
        first, last = (0.0, 0.0) if terms.restarts[t, i] else (low[t + 1], high[t + 1])
    return low, high


def _origin(layout: ContractLayout, terms, i: int) -> float:
    """A point of evenly spaced nodes: the limit of a level that only rises, if the limit is
    constant, since the value bends at all levels from which whole volumes lead to that limit.
    Otherwise it is zero, and also if another limit falls at multiples."""
    if terms.falling is not None:
        return 0.0
    limit, effects = terms.high[:, i], [flow.effects[i] for flow in layout.flows]
    effects += [move.changes[i] for move in layout.every_move]
    return float(limit[0]) if min(effects) >= 0 and np.ptp(limit) == 0 else 0.0


def _regular(low, high, width: float, restarts, origin: float | None = None):
    """Nodes at multiples of the width; with an `origin`, nodes at multiples counted from it, and at
    both ends."""
    zero = origin or 0.0

    def nodes(a: float, b: float) -> np.ndarray:
        first, last = np.ceil((a - zero) / width - 1e-6), np.floor((b - zero) / width + 1e-6)
        inner = zero + np.arange(first, last + 1) * width
        if origin is None and len(inner):
            return inner
        inner = inner[(inner > a + 1e-6 * width) & (inner < b - 1e-6 * width)]
        return np.unique(np.concatenate([[a], inner, [b]]))

    after = [nodes(a, b) for a, b in zip(low[1:], high[1:])]
    return [nodes(low[0], high[0]), *_settled(after, restarts)], after


def _settled(after: list[np.ndarray], restarts) -> list[np.ndarray]:
    return [np.zeros(1) if again else points for points, again in zip(after, restarts)]


def _breakpoints(layout: ContractLayout, terms, start, i: int, low, high):
    """All levels to which the largest and smallest flows lead; None if there are too many.

    The nodes of each step are moved to the next step and back until no new node appears, at most
    three times.
    """
    horizon, restarts = len(terms.low), terms.restarts[:, i]
    near = NEAR * max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    after = []
    for t in range(horizon):
        limits = np.array([low[t + 1], high[t + 1], terms.low[t, i], terms.high[t, i]])
        if restarts[t]:
            limits = np.append(limits, terms.owed[t, i])
        if terms.of_levels is not None:  # whose money bends at zero
            limits = np.append(limits, 0.0)
        after.append(_within(limits, low[t + 1], high[t + 1], near))
    first = np.array([start[i]])
    for _ in range(3):
        count = sum(map(len, after))
        before = [first, *_settled(after, restarts)]
        for t in range(horizon):
            shifted = (before[t][:, None] + extremes(layout, terms, t, i)).ravel()
            after[t] = _within(np.append(after[t], shifted), low[t + 1], high[t + 1], near)
            if len(after[t]) > MOST:
                return None
            before[t + 1] = np.zeros(1) if restarts[t] else after[t]
        for t in reversed(range(1, horizon)):
            if not restarts[t - 1]:
                shifted = (after[t][:, None] - extremes(layout, terms, t, i)).ravel()
                after[t - 1] = _within(np.append(after[t - 1], shifted), low[t], high[t], near)
                if len(after[t - 1]) > MOST:
                    return None
        if sum(map(len, after)) == count:
            break
    return [first, *_settled(after, restarts)], after


def _within(points: np.ndarray, low: float, high: float, near: float) -> np.ndarray:
    points = np.sort(points[(points >= low - near) & (points <= high + near)])
    return points[np.append(True, np.diff(points) > near)] if len(points) else points
