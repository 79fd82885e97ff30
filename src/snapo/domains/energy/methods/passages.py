"""Passages from the nodes of one step to the nodes of the next step: volumes of a move from each
node."""

from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..core.contract import ContractLayout, FallingLimit
from .corners import corners


class Passage(NamedTuple):
    """A volume along a flow, from some nodes of a step to nodes after it.

    - `flow`: the index of the flow, -1 for none; `volume`: its volume.
    - `rows`, `goals`: the nodes where it begins and ends, two blocks of the same shape, each a
      slice of every level.
    - `weights` [corners, rows, 1]: the weights of the nodes around the end, if the end is not a
      node. `rows` are then the numbers of the nodes at the beginning, and `goals` [corners, rows]
      the numbers of the nodes around each end.
    """

    flow: int
    volume: float
    rows: Any
    goals: Any
    weights: np.ndarray | None = None


Passages = tuple[tuple[Passage, ...], ...]  # of a step, by move


def passages_of(layout: ContractLayout, terms, t: int, before, after, near: float) -> Passages:
    """The passages of step t from the nodes `before` it to the nodes `after` it."""
    signs, result = layout.signs, []
    free = (np.full(len(before), -np.inf), np.full(len(before), np.inf))
    for m, move in enumerate(layout.every_move):
        passages: list[Passage] = []
        changes, lower, upper = np.array(move.changes), terms.least[t], terms.most[t]
        if terms.fixed_volume is not None:
            lower = upper = np.full(len(lower), terms.fixed_volume[t, m])
        limits = free if terms.of_moves is None else tuple(x[t, m] for x in terms.of_moves)
        nodes = before, after, limits, signs, near
        still = all(lower[flow] <= near for flow in move.flows)
        if still:
            passages += _moved(-1, 0.0, changes, (), *nodes)
        for flow in move.flows:
            effects = np.array(layout.flows[flow].effects)
            ends = float(lower[flow]), float(upper[flow])
            touched = np.flatnonzero(effects)
            for volume in _possible(effects, changes, ends, before, after, near):
                if volume > near or not still:
                    change = changes + volume * effects
                    pinned = () if volume in ends else touched
                    for within in _by_falls(terms, t, limits, change, before, near):
                        passages += _moved(
                            flow, volume, change, pinned, before, after, within, signs, near
                        )
        result.append(tuple(passages))
    return tuple(result)


def _by_falls(terms, t: int, limits, change, before, near: float) -> list:
    """The limits of a volume, one pair for each number of falls that the falling limit may have
    had."""
    if terms.falling is None or change[0] <= 0:
        return [limits]
    falling, result = FallingLimit(*(x[t] for x in terms.falling)), []
    near = 8 * near  # limits are met with half of it
    counted = before[-1] + change[-1]
    for falls in np.unique(falling.falls(counted, near, np)):
        low, high = (np.array(x, float) for x in limits)
        high[0] = min(high[0], terms.high[t, 0] - falls * falling.by)
        high[-1] = min(high[-1], (falls + 1) * falling.every)
        if falls:
            low[-1] = max(low[-1], falls * falling.every + near)
        result.append((low, high))
    return result


def _possible(effects, changes, ends, before, after, near: float) -> list[float]:
    """The volumes to try: the two ends of the interval, and the volumes between them that lead from
    a node of a level to a node of the same level."""
    volumes = list(ends)
    for i in np.flatnonzero(effects):
        every = ((after[i][None, :] - before[i][:, None] - changes[i]) / effects[i]).ravel()
        inside = every[(every > ends[0] + near) & (every < ends[1] - near)]
        volumes += inside.tolist()
    rounded = np.round(np.array(volumes) / (10 * near))
    return [volumes[k] for k in np.unique(rounded, return_index=True)[1]]


def _moved(flow: int, volume: float, change, pinned, before, after, limits, signs, near: float):
    """The passages of one volume: from nodes that it moves to a node, and from nodes that it moves
    to a point between nodes. If there are `pinned` levels, the latter are used only if they end on
    a node of such a level, since values are linear between nodes. All passages end between the
    `limits` [2][levels] of the move."""
    if not before:
        return [Passage(flow, volume, (), ())]
    goals, positions, on, inside = [], [], [], []
    for points, nodes, moved, low, high in zip(before, after, change, *limits):
        goal = points + moved
        allowed = (goal >= low - 4 * near) & (goal <= high + 4 * near)
        position = np.clip(np.searchsorted(nodes, goal - 4 * near), 0, len(nodes) - 1)
        goals.append(goal)
        positions.append(position)
        on.append(allowed & (np.abs(nodes[position] - goal) <= 4 * near))
        inside.append(allowed & (goal >= nodes[0] - near) & (goal <= nodes[-1] + near))
    blocks = product(*(_runs(np.flatnonzero(x), position) for x, position in zip(on, positions)))
    result: list[Passage] = []
    for block in blocks:
        rows, there = zip(*block)
        result.append(Passage(flow, volume, rows, there))
    chosen = np.stack(np.meshgrid(*map(np.flatnonzero, inside), indexing="ij"), -1)
    chosen = chosen.reshape(-1, len(on))
    hits = np.stack([x[i] for x, i in zip(on, chosen.T)])
    between = ~hits.all(axis=0)
    if len(pinned):
        between &= hits[pinned].any(axis=0)
    if between.any():
        chosen = chosen[between]
        levels = np.stack([goal[i] for goal, i in zip(goals, chosen.T)], axis=1)
        around, weights = corners(after, levels, signs)
        used = weights.any(axis=1)
        rows = np.ravel_multi_index(tuple(chosen.T), [len(x) for x in before])
        result.append(Passage(flow, volume, rows, around[used], weights[used, :, None]))
    return result


def _runs(rows: np.ndarray, positions: np.ndarray) -> list[tuple[slice, slice]]:
    """Blocks of rows and of their positions, in which both rise by one."""
    if not len(rows):
        return []
    there = positions[rows]
    cuts = np.flatnonzero((np.diff(rows) != 1) | (np.diff(there) != 1)) + 1
    return [
        (slice(int(a[0]), int(a[-1]) + 1), slice(int(b[0]), int(b[-1]) + 1))
        for a, b in zip(np.split(rows, cuts), np.split(there, cuts))
    ]
