"""Nodes of the levels of a contract, and every way from the nodes of one step to those of the next.

Values are linear between nodes. Where flows, limits and starts have a common measure, nodes are its
multiples, and all volumes that a best decision can take lead from node to node: values there are
exact, neither raised nor lowered. A single level without a practical measure has its breakpoints as
nodes: all levels to which extreme flows lead from the start and from the limits, forwards and
backwards. Only where these are too many are nodes evenly spaced, and values between them linear
(`exact` is false then: they are approximate, and no bound).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..core.contract import ContractLayout
from .measure import measures_of

MOST = 1200  # nodes of a level
TOGETHER = 20_000  # of all levels
COARSE = {1: 401, 2: 49, 3: 17}  # of a level where these are too many, by the number of levels
NEAR = 1e-9  # of the largest volume: nearer levels are one


class Passage(NamedTuple):
    """A volume along a flow, from some nodes of a step to nodes after it.

    - `flow`: its index, -1 for none; `volume`: how much.
    - `rows`: numbers of nodes before. `goals` [corners, rows]: those after, with their `weights`
      [corners, rows, 1], None where each one ends at a node.
    """

    flow: int
    volume: float
    rows: np.ndarray
    goals: np.ndarray
    weights: np.ndarray | None


class StepGrid(NamedTuple):
    """One step: the passages of each move; nodes `before` and `after` it, an array by level.

    - `arrive`: the number of the node of the next step for each node after; `lost`: what settling
      takes there, in money.
    """

    passages: tuple[tuple[Passage, ...], ...]
    before: tuple[np.ndarray, ...]
    after: tuple[np.ndarray, ...]
    arrive: np.ndarray
    lost: np.ndarray


@dataclass(frozen=True, eq=False)
class ContractGrid:
    """All steps of a contract with NumPy numbers; `exact`: see above."""

    layout: ContractLayout
    steps: list[StepGrid]
    last: tuple[np.ndarray, ...]
    exact: bool

    @cached_property
    def nodes(self) -> list[tuple[np.ndarray, ...]]:
        """[T + 1] at the start of each step, and after the last one."""
        return [step.before for step in self.steps] + [self.last]

    def size(self, t: int) -> int:
        """How many nodes there are at the start of a step."""
        return int(np.prod([len(x) for x in self.nodes[t]], dtype=int))


def grid_of(layout: ContractLayout, schedule: Any, parts: int = 1) -> ContractGrid:
    """The grid of a schedule with NumPy leaves; `parts`: of the measure, for a finer one."""
    terms, found = schedule.steps.terms, schedule.steps.intervals
    start = np.asarray(schedule.constants.start, float)
    before, after, exact = _nodes(layout, terms, found, start, parts)
    scale = max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    known: dict[tuple, tuple] = {}
    steps = []
    for t in range(len(after)):
        numbers = [terms.least[t], terms.most[t], *before[t], *after[t]]
        key = tuple(np.asarray(x).tobytes() for x in numbers)
        if key not in known:
            known[key] = _passages(layout, terms, t, before[t], after[t], NEAR * scale)
        arrive, lost = _arrivals(terms, t, after[t], before[t + 1])
        steps.append(StepGrid(known[key], before[t], after[t], arrive, lost))
    return ContractGrid(layout, steps, before[-1], exact)


def best(
    step: StepGrid, layout: ContractLayout, cash: np.ndarray, fixed: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """[modes, nodes, columns] the value of the best move and volume from each node.

    `cash` [flows, columns]: earnings of a unit; `fixed` [moves]; `after` [modes, nodes after,
    columns]. Columns are nodes of price factors, or paths.
    """
    count = int(np.prod([len(x) for x in step.before], dtype=int))
    value = np.full((len(layout.modes), count, after.shape[2]), -np.inf)
    for move, passages, money in zip(layout.every_move, step.passages, fixed):
        here, there = value[move.before], after[move.after]
        for flow, volume, rows, goals, weights in passages:
            reached = there[goals[0]]
            if weights is not None:
                reached = np.sum(weights * there[goals], axis=0)
            if flow >= 0 and volume:
                reached = reached + volume * cash[flow]
            if money:
                reached = reached + money
            here[rows] = np.maximum(here[rows], reached)
    return value


def arrived(step: StepGrid, value: np.ndarray) -> np.ndarray:
    """[modes, nodes after, columns] of the value at the start of the next step, after settling."""
    result = value[:, step.arrive]
    return result - step.lost[:, None] if step.lost.any() else result


def _nodes(layout: ContractLayout, terms, found, start, parts: int):
    """Nodes at the start of each step [T + 1] and after each [T], by level; and whether exact."""
    horizon, count = len(terms.low), len(layout.levels)
    measures = measures_of(layout, terms, start)
    visited = [_visited(layout, terms, found, start, i) for i in range(count)]
    widest = [float(np.max(high - low)) for low, high in visited]
    sizes = [w / m if m else np.inf for w, m in zip(widest, measures)]
    together = math.prod(x + 1 for x in sizes)
    exact = all(x <= MOST for x in sizes) and together <= TOGETHER
    columns = []
    for i, (low, high) in enumerate(visited):
        restarts, measure = terms.restarts[:, i], measures[i]
        if exact and measure is not None:
            columns.append(_regular(low, high, measure / parts, restarts))
            continue
        points = _breakpoints(layout, terms, start, i, low, high) if count == 1 else None
        if points is None:
            width = widest[i] / (COARSE[min(count, 3)] - 1) / parts
            points = _regular(low, high, width or 1.0, restarts, ends=True)
        else:
            exact = True
        columns.append(points)
    before = [tuple(c[0][t] for c in columns) for t in range(horizon + 1)]
    after = [tuple(c[1][t] for c in columns) for t in range(horizon)]
    return before, after, exact


def _visited(layout, terms, found, start, i) -> tuple[np.ndarray, np.ndarray]:
    """[T + 1] of a level: start, and after each step, before settling; feasible and reachable."""
    horizon = len(terms.low)
    low, high = np.empty(horizon + 1), np.empty(horizon + 1)
    low[0] = high[0] = first = last = start[i]
    for t in range(horizon):
        change = _extremes(layout, terms, t, i)
        low[t + 1] = min(max(first + change.min(), found.next_low[t, i]), found.next_high[t, i])
        high[t + 1] = max(min(last + change.max(), found.next_high[t, i]), low[t + 1])
        first, last = (0.0, 0.0) if terms.restarts[t, i] else (low[t + 1], high[t + 1])
    return low, high


def _extremes(layout: ContractLayout, terms, t: int, i: int) -> np.ndarray:
    """What a step can change a level by, at the ends of each flow."""
    result = set()
    for move in layout.every_move:
        if all(terms.least[t, flow] <= 0 for flow in move.flows):
            result.add(move.changes[i])
        for flow in move.flows:
            effect = layout.flows[flow].effects[i]
            ends = terms.least[t, flow], terms.most[t, flow]
            result |= {move.changes[i] + effect * volume for volume in ends}
    return np.array(sorted(result))


def _regular(low, high, width: float, restarts, ends: bool = False):
    """Multiples of the width, and both ends where they are none."""

    def nodes(a: float, b: float) -> np.ndarray:
        inner = np.arange(np.ceil(a / width - 1e-6), np.floor(b / width + 1e-6) + 1) * width
        if not ends and len(inner):
            return inner
        inner = inner[(inner > a + 1e-6 * width) & (inner < b - 1e-6 * width)]
        return np.unique(np.concatenate([[a], inner, [b]]))

    after = [nodes(a, b) for a, b in zip(low[1:], high[1:])]
    return [nodes(low[0], high[0]), *_settled(after, restarts)], after


def _settled(after: list[np.ndarray], restarts) -> list[np.ndarray]:
    return [np.zeros(1) if again else points for points, again in zip(after, restarts)]


def _breakpoints(layout: ContractLayout, terms, start, i: int, low, high):
    """All levels to which extreme flows lead; None where they are too many.

    The nodes of a step are led to those of the next one and back until none is missing.
    """
    horizon, restarts = len(terms.low), terms.restarts[:, i]
    near = NEAR * max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    after = []
    for t in range(horizon):
        limits = np.array([low[t + 1], high[t + 1], terms.low[t, i], terms.high[t, i]])
        if restarts[t]:
            limits = np.append(limits, terms.owed[t, i])
        after.append(_within(limits, low[t + 1], high[t + 1], near))
    first = np.array([start[i]])
    for _ in range(3):
        count = sum(map(len, after))
        before = [first, *_settled(after, restarts)]
        for t in range(horizon):
            moved = (before[t][:, None] + _extremes(layout, terms, t, i)).ravel()
            after[t] = _within(np.append(after[t], moved), low[t + 1], high[t + 1], near)
            if len(after[t]) > MOST:
                return None
            before[t + 1] = np.zeros(1) if restarts[t] else after[t]
        for t in reversed(range(1, horizon)):
            if not restarts[t - 1]:
                moved = (after[t][:, None] - _extremes(layout, terms, t, i)).ravel()
                after[t - 1] = _within(np.append(after[t - 1], moved), low[t], high[t], near)
                if len(after[t - 1]) > MOST:
                    return None
        if sum(map(len, after)) == count:
            break
    return [first, *_settled(after, restarts)], after


def _within(points: np.ndarray, low: float, high: float, near: float) -> np.ndarray:
    points = np.sort(points[(points >= low - near) & (points <= high + near)])
    return points[np.append(True, np.diff(points) > near)] if len(points) else points


def _passages(layout: ContractLayout, terms, t: int, before, after, near: float):
    opposed, result = opposed_levels(layout), []
    for move in layout.every_move:
        passages: list[Passage] = []
        changes = np.array(move.changes)
        still = all(terms.least[t, flow] <= near for flow in move.flows)
        if still:
            passages += _moved(-1, 0.0, changes, before, after, opposed, near)
        for flow in move.flows:
            effects = np.array(layout.flows[flow].effects)
            ends = terms.least[t, flow], terms.most[t, flow]
            for volume in _possible(effects, changes, ends, before, after, near):
                if volume > near or not still:
                    change = changes + volume * effects
                    passages += _moved(flow, volume, change, before, after, opposed, near)
        result.append(tuple(passages))
    return tuple(result)


def _possible(effects, changes, ends, before, after, near: float) -> list[float]:
    """The volumes to try: both ends, and those that lead from a node to a node between them."""
    volumes = [float(ends[0]), float(ends[1])]
    touched = np.flatnonzero(effects)
    if len(touched):
        i = touched[0]
        every = ((after[i][None, :] - before[i][:, None] - changes[i]) / effects[i]).ravel()
        inside = every[(every > ends[0] + near) & (every < ends[1] - near)]
        volumes += inside.tolist()
    rounded = np.round(np.array(volumes) / (10 * near))
    return [volumes[k] for k in np.unique(rounded, return_index=True)[1]]


def _moved(flow: int, volume: float, change, before, after, opposed: bool, near: float):
    """The passages of one volume: from the nodes that it moves to a node, and from the others that
    it moves between nodes."""
    if not before:
        return [Passage(flow, volume, np.zeros(1, int), np.zeros((1, 1), int), None)]
    goals, on, inside = [], [], []
    for points, nodes, moved in zip(before, after, change):
        goal = points + moved
        right = np.clip(np.searchsorted(nodes, goal - 2 * near), 0, len(nodes) - 1)
        goals.append(goal)
        on.append(np.abs(nodes[right] - goal) <= 4 * near)
        inside.append((goal >= nodes[0] - near) & (goal <= nodes[-1] + near))
    strides, result = _strides(before), []
    exact = [np.flatnonzero(x) for x in on]
    if all(map(len, exact)):
        places = [np.searchsorted(n, g[x] - 4 * near) for n, g, x in zip(after, goals, exact)]
        goal = _flat(places, _strides(after))
        result.append(Passage(flow, volume, _flat(exact, strides), goal[None], None))
    if all(x.any() for x in inside) and not all(np.array_equal(a, b) for a, b in zip(on, inside)):
        possible = [np.flatnonzero(x) for x in inside]
        rows = _flat(possible, strides)
        mesh = np.meshgrid(*(g[x] for g, x in zip(goals, possible)), indexing="ij")
        levels = np.stack([x.ravel() for x in mesh], axis=1)
        found, weights = corners(after, levels, opposed)
        result.append(Passage(flow, volume, rows, found, weights[:, :, None]))
    return result


def opposed_levels(layout: ContractLayout) -> bool:
    """Whether a flow moves two levels in opposite directions."""
    return any(np.min(f.effects, initial=0.0) < 0 < np.max(f.effects, initial=0.0)
               for f in layout.flows)  # fmt: skip


def corners(nodes, levels: np.ndarray, opposed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes [corners, points] around levels [points, levels], and their weights.

    One level is cut at its nodes; two are cut along their flows too, into triangles, so that a
    function between nodes is linear along every flow and the best volumes lead to nodes.
    """
    count, sizes = len(levels), [len(x) for x in nodes]
    if not sizes:
        return np.zeros((1, count), int), np.ones((1, count))
    lefts, shares = [], []
    for i, x in enumerate(nodes):
        position = np.interp(levels[:, i], x, np.arange(len(x), dtype=float))
        left = np.minimum(position.astype(int), max(len(x) - 2, 0))
        lefts.append(left)
        shares.append(position - left)
    if len(sizes) == 1:
        right = np.minimum(lefts[0] + 1, sizes[0] - 1)
        return np.stack([lefts[0], right]), np.stack([1 - shares[0], shares[0]])
    if len(sizes) > 2:
        raise ValueError("a contract of three levels that its volumes do not share has no grid")
    first, second = shares[0], 1 - shares[1] if opposed else shares[1]

    def at(i, j) -> np.ndarray:
        row = np.minimum(lefts[0] + i, sizes[0] - 1)
        return row * sizes[1] + np.minimum(lefts[1] + (1 - j if opposed else j), sizes[1] - 1)

    zero, wide = np.zeros(count, int), first >= second
    middle = at(np.where(wide, 1, 0), np.where(wide, 0, 1))
    weights = [1 - np.maximum(first, second), np.abs(first - second), np.minimum(first, second)]
    return np.stack([at(zero, zero), middle, at(zero + 1, zero + 1)]), np.stack(weights)


def _strides(nodes) -> list[int]:
    return _strides_of([len(x) for x in nodes])


def _strides_of(shape) -> list[int]:
    return [int(np.prod(shape[i + 1 :], dtype=int)) for i in range(len(shape))]


def _flat(indices, strides) -> np.ndarray:
    """Numbers of nodes from those by level, of all combinations."""
    result = np.zeros(1, int)
    for index, stride in zip(indices, strides):
        result = (result[:, None] + stride * np.asarray(index)[None, :]).ravel()
    return result


def _arrivals(terms, t: int, after, following) -> tuple[np.ndarray, np.ndarray]:
    places, lost = [], np.zeros(1)
    for i, points in enumerate(after):
        again = bool(terms.restarts[t, i])
        places.append(np.zeros(len(points), int) if again else np.arange(len(points)))
        missed = np.maximum(terms.owed[t, i] - points, 0.0) if again else np.zeros(len(points))
        amount = missed * terms.short[t, i] if again else missed
        lost = (lost[:, None] + amount[None, :]).ravel()
    return _flat(places, _strides(following)), lost


def node_levels(nodes: tuple[np.ndarray, ...]) -> np.ndarray:
    """[n, levels] of all nodes."""
    return np.array(list(product(*nodes))).reshape(-1, len(nodes))
