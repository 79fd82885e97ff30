"""The inventories that the flows of a day reach between two grids, as numbers of nodes."""

from typing import NamedTuple

import numpy as np

from ..references.day_terms import volume_scale

ON_NODE = 1e-9  # in spacings: a position this near to a node is that node

GridRows = slice | np.ndarray  # numbers of rows: a slice where they follow one another


class ReachableLevels(NamedTuple):
    """The inventories at the end of the day that one direction of flow reaches from each node at
    its start.

    - `inside`: groups (k, rows, first, last): 2^k nodes from `first` and 2^k nodes up to `last`
      cover all nodes within reach.
    - `endpoints`: (rows, left, right, share): the ends of the reach that are between two nodes.
    """

    inside: list[tuple[int, GridRows, GridRows, GridRows]]
    endpoints: list[tuple[GridRows, GridRows, GridRows, np.ndarray]]


class Bends(NamedTuple):
    """Inventories between nodes whose reach has a node as endpoint: the value may bend there. They
    are sorted by cell. `left` and `right` are the nodes of the cell, `share` the share of the way
    from left to right, `target` the node at the endpoint, and `keep` the inventory without any
    flow. `cells` are the cells with bends, and `starts` the first bend of each of them, None if
    each has only one.
    """

    left: GridRows
    right: GridRows
    share: np.ndarray
    target: GridRows
    keep: np.ndarray
    cells: GridRows
    starts: np.ndarray | None


def reach(
    after: np.ndarray, low: np.ndarray, high: np.ndarray, valid: np.ndarray
) -> ReachableLevels:
    """The nodes and the ends of the reach between `low` and `high`, for rows that are `valid`; all
    arguments are [n]."""
    positions = [np.interp(item, after, np.arange(len(after), dtype=float)) for item in (low, high)]
    endpoints = []
    for position in positions:
        complete = np.round(position)
        between = valid & (np.abs(position - complete) > ON_NODE)
        rows = np.flatnonzero(between)
        left = np.floor(position[rows]).astype(int)
        if len(rows):
            share = (position[rows] - left)[:, None]
            endpoints.append((_rows(rows), _rows(left), _rows(left + 1), share))
    first = np.ceil(positions[0] - ON_NODE).astype(int)
    last = np.floor(positions[1] + ON_NODE).astype(int)
    count = np.where(valid, last - first + 1, 0)
    inside = []
    for k in range(int(np.max(count, initial=0)).bit_length()):
        rows = np.flatnonzero((count >> k) == 1)
        if len(rows):
            ending = last[rows] - (1 << k) + 1
            inside.append((k, _rows(rows), _rows(first[rows]), _rows(ending)))
    return ReachableLevels(inside, endpoints)


def bends(
    schedule,
    reached: tuple[np.ndarray, np.ndarray, np.ndarray],
    nodes: np.ndarray,
    after: np.ndarray,
) -> tuple[Bends | None, Bends | None]:
    """The bends of buying and of selling; `reached`: see `flow_ends`.

    The bends are the inventories from which a full flow ends exactly at a node, before limits
    apply; the value is linear between nodes."""
    keep, down, up = reached
    meetings = [_meetings(item, after) for item in (down, up, keep)]
    cell, share, target = (np.concatenate(entry) for entry in zip(*meetings, strict=True))

    def at(line: np.ndarray) -> np.ndarray:
        return (1 - share) * line[cell] + share * line[cell + 1] if len(nodes) > 1 else share

    near, goal, selected = ON_NODE * volume_scale(schedule), after[target], at(keep)
    possible = (goal >= at(down) - near) & (goal <= at(up) + near)
    rising = goal >= selected
    order = np.argsort(cell, kind="stable")
    table = cell, share, target, selected
    return tuple(  # pyright: ignore[reportReturnType]
        _sorted(*(value[order[(possible & side)[order]]] for value in table))
        for side in (rising, ~rising)
    )


def _meetings(
    endpoints: np.ndarray, after: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(cell, share, node) of all points inside a cell at which the line through `endpoints` [n]
    crosses a node."""
    low, high = np.minimum(endpoints[:-1], endpoints[1:]), np.maximum(endpoints[:-1], endpoints[1:])
    first = np.searchsorted(after, low, side="right")
    count = np.maximum(np.searchsorted(after, high, side="left") - first, 0)
    cell = np.repeat(np.arange(len(low)), count)
    node = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count) + first[cell]
    share = (after[node] - endpoints[cell]) / (endpoints[cell + 1] - endpoints[cell])
    inner = (share > ON_NODE) & (share < 1 - ON_NODE)
    return cell[inner], share[inner], node[inner]


def _sorted(cell, share, target, keep) -> Bends | None:
    if not len(cell):
        return None
    cells, starts = np.unique(cell, return_index=True)
    several = starts if len(cells) < len(cell) else None
    positions = _rows(cell), _rows(cell + 1), share[:, None], _rows(target)
    return Bends(*positions, keep[:, None], _rows(cells), several)


def _rows(numbers: np.ndarray) -> GridRows:
    first, last = numbers[0], numbers[-1]
    if last - first == len(numbers) - 1 and (numbers[1:] - numbers[:-1] == 1).all():
        return slice(int(numbers[0]), int(numbers[-1]) + 1)
    return numbers
