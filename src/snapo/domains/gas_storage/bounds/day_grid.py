"""One day of a store on a grid of inventories: the reach of each start, and the best flows.

The grid does not depend on prices: all paths share it. Positions at the end of the day are counted
in nodes of the grid there. The value after the day is linear between nodes. The best flow to a
node or to an end of the reach is then exact at every start-of-day node. Between two nodes the value
is convex except for its bends (`DayGrid.buy_bends`): with one more gain there, a line between
raised nodes is an upper bound.
"""

from typing import NamedTuple

import numpy as np

from ..references.breakpoints import breakpoints
from ..references.day_terms import (
    POINT,
    DayRates,
    Interpolation,
    UnitPrices,
    flow_ends,
    holding_cost,
    moves,
    rates,
    volume_scale,
)
from ..references.intrinsic import values_after
from ..references.lattice_day import inventory_nodes
from ..references.piecewise import PiecewiseLine, visited
from . import day_code

BENDS = 0.5  # most nodes at bends of the intrinsic value, of the regular ones
SLIGHT = 1e-3  # bends below this part of the sharpest one are left out
NEAR = 0.02  # in spacings: nodes are not nearer to one another than this
ON_NODE = 1e-9  # in spacings: a position this near to a node is that node


GridRows = slice | np.ndarray  # numbers of rows: a slice where they follow one another


class ReachableLevels(NamedTuple):
    """The ends of the day that one direction of flow reaches, by start-of-day node.

    - `inside`: (k, rows, first, last) in groups: 2^k nodes from `first` and 2^k nodes up to `last`
      cover all nodes within reach.
    - `endpoints`: (rows, left, right, share): ends of the reach that lie between two nodes.
    """

    inside: list[tuple[int, GridRows, GridRows, GridRows]]
    endpoints: list[tuple[GridRows, GridRows, GridRows, np.ndarray]]


class Bends(NamedTuple):
    """Inventories between nodes where an end of the reach meets a node: the value may bend there.

    Sorted by cell, which lies between nodes `left` and `right`; `share` of the way to the right,
    `target` the node met, `keep` the inventory without any flow. `cells` are those with bends,
    `starts` the first bend of each, None if each has one.
    """

    left: GridRows
    right: GridRows
    share: np.ndarray
    target: GridRows
    keep: np.ndarray
    cells: GridRows
    starts: np.ndarray | None


class DayGrid(NamedTuple):
    """A decision day between two grids.

    - `nodes` [n] at its start, `after` [m] at its end; `keep` [n] and `cost` [n]: the gas without
      a flow, and the present value of keeping it.
    - `buy`, `sell`, and the bends of each; `code`: the same for machine code.
    """

    nodes: np.ndarray
    after: np.ndarray
    keep: np.ndarray
    cost: np.ndarray
    buy: ReachableLevels
    sell: ReachableLevels
    buy_bends: Bends | None
    sell_bends: Bends | None
    code: day_code.DayCode


def day_grids(
    schedule, interpolation: Interpolation, inventories: int, bends: bool = True
) -> list[DayGrid]:
    """All T days; the value of the best flow is linear between nodes where that is possible.

    Without `bends` the grids are for values of the best flow, not for values above them.

    Only inventories that the one in store can become. See `breakpoints` of the references for
    contracts with constant rates. Of others there are `inventories` points from 0 to the largest
    inventory. Ratchet rows are nodes, and so are the inventories where the intrinsic value bends
    most: those that just can be emptied or filled in time keep their bend whatever prices do, and
    a bend between nodes costs most.
    """
    horizon = len(schedule.steps.forward)
    low, high = visited(schedule, interpolation)
    day_rates = [rates(schedule, interpolation, t) for t in range(horizon)]
    nodes = breakpoints(schedule, interpolation, low, high)
    if nodes is None:
        spacing = spacing_of(schedule, inventories, float(np.max(high - low)))
        maximum = int(BENDS * inventories)
        lines = values_after(schedule, interpolation, low, high)
        levels = [day.levels for day in day_rates] + [schedule.constants.end_levels]
        nodes = [inventory_nodes(low[0], high[0], spacing, levels[0])]
        for t in range(horizon):
            regular = inventory_nodes(low[t + 1], high[t + 1], spacing, levels[t + 1])
            bent = _bent(lines[t], maximum)
            nodes.append(_joined(regular, bent, spacing, levels[t + 1]))
    return [
        one_day(schedule, day_rates[t], t, nodes[t], nodes[t + 1], bends) for t in range(horizon)
    ]


def largest_rate(schedule) -> float:
    """The largest volume that may flow on a day."""
    steps = schedule.steps
    return float(max(np.max(steps.injection_rate), np.max(steps.withdrawal_rate)))


def spacing_of(schedule, inventories: int, widest: float) -> float:
    """The spacing of the regular nodes: where it can, a part of the largest flow, which then ends
    on a node.

    `widest`: the widest interval of inventories that the one in store can become.
    """
    spacing, rate = widest / (inventories - 1), largest_rate(schedule)
    parts = round(rate / spacing) if spacing > 0 else 0
    return float(rate / parts) if parts else max(spacing, POINT * volume_scale(schedule))


def _bent(line: PiecewiseLine, maximum: int) -> np.ndarray:
    """The inner breakpoints with the largest kinks of a line, up to a maximum number."""
    if len(line.at) < 3:
        return np.zeros(0)
    change = np.abs(np.diff(np.diff(line.value) / np.diff(line.at)))
    selected = np.argsort(-change, kind="stable")[:maximum]
    return np.sort(line.at[1:-1][selected[change[selected] > SLIGHT * change.max()]])


def _joined(regular: np.ndarray, bent: np.ndarray, spacing: float, levels) -> np.ndarray:
    """Regular nodes, those near a bend replaced by it; ends and ratchet rows stay."""
    bent = bent[(bent > regular[0] + NEAR * spacing) & (bent < regular[-1] - NEAR * spacing)]
    fixed = np.concatenate([regular[[0, -1]], levels])
    bent = bent[np.abs(bent[:, None] - fixed).min(axis=1) > NEAR * spacing]
    bent = bent[np.append(True, np.diff(bent) > NEAR * spacing)[: len(bent)]]
    if not len(bent):
        return regular
    near = np.abs(regular[:, None] - bent[None, :]).min(axis=1) < spacing / 3
    return np.union1d(regular[~near | np.isin(regular, fixed)], bent)


def one_day(
    schedule, day_rates: DayRates, t: int, nodes: np.ndarray, after: np.ndarray, bends: bool
) -> DayGrid:
    """Day t between two grids."""
    keep, down, _, up = moves(schedule, day_rates, t, nodes)
    near = ON_NODE * volume_scale(schedule)
    return DayGrid(
        nodes,
        after,
        keep,
        holding_cost(schedule, t, nodes),
        _reach(after, np.minimum(np.maximum(down, keep), up), up, up >= keep - near),
        _reach(after, down, np.maximum(np.minimum(up, keep), down), down <= keep + near),
        *(_bends(schedule, day_rates, t, nodes, after) if bends else (None, None)),
        day_code.DayCode(),
    )


def _reach(
    after: np.ndarray, low: np.ndarray, high: np.ndarray, valid: np.ndarray
) -> ReachableLevels:
    """The nodes and the ends between `low` and `high`, where `valid`; all [n]."""
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


def _bends(
    schedule, day_rates: DayRates, t: int, nodes, after
) -> tuple[Bends | None, Bends | None]:
    """The inventories from which a full flow ends exactly at a node, before limits apply; the
    value is linear between nodes."""
    keep, down, up = flow_ends(schedule, day_rates, t, nodes)
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
    """(cell, share, node) wherever a line through `endpoints` [n] crosses a node inside a cell."""
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


def best_value(day: DayGrid, prices: UnitPrices, after: np.ndarray, above: bool) -> np.ndarray:
    """The value at the start of the day [n, columns] of the best flow, from that at its end.

    **Arguments:**

    - `prices`: present values of a unit bought and sold, [columns] each.
    - `after` [m, columns]: the value on the day's last nodes, linear between them.
    - `above`: the result, linear between nodes, is never below the value of the best flow from
      there; otherwise it equals that value at the nodes, and may be below it in between.
    """
    if day_code.serves(after.shape[1]):
        return day_code.best_value(day, prices.pay, prices.earn, after, above)
    keep = day.keep[:, None]
    buying = _less(after, day.after, prices.pay)
    selling = _less(after, day.after, prices.earn)
    value = _best_within(buying, day.buy, len(keep))
    value += keep * prices.pay
    other = _best_within(selling, day.sell, len(keep))
    other += keep * prices.earn
    np.maximum(value, other, out=value)
    if above:
        excess = np.zeros((len(keep) - 1, after.shape[1]))
        _exceed(excess, value, buying, prices.pay, day.buy_bends)
        _exceed(excess, value, selling, prices.earn, day.sell_bends)
        # A node serves two cells, and is raised by the larger gap of the two.
        if len(excess):
            value[0] += excess[0]
            value[-1] += excess[-1]
            value[1:-1] += np.maximum(excess[:-1], excess[1:])
    if day.cost.any():
        value -= day.cost[:, None]
    return value


def _less(after: np.ndarray, nodes: np.ndarray, price: np.ndarray) -> np.ndarray:
    """The value after the day less that of the gas at a price: [m, columns]."""
    value = np.multiply.outer(nodes, price)
    return np.subtract(after, value, out=value)


def _best_within(line: np.ndarray, reach: ReachableLevels, rows: int) -> np.ndarray:
    """[rows, columns] the maximum of a piecewise linear function on nodes, within reach."""
    best = np.full((rows, line.shape[1]), -np.inf)
    levels = [line]
    for k, selected, first, last in reach.inside:
        while len(levels) <= k:
            wide, step = levels[-1], 1 << (len(levels) - 1)
            levels.append(np.maximum(wide[:-step], wide[step:]))
        best[selected] = np.maximum(levels[k][first], levels[k][last]) if k else line[first]
    for selected, left, right, share in reach.endpoints:
        result = line[right] - line[left]
        result *= share
        result += line[left]
        best[selected] = np.maximum(best[selected], result)
    return best


def _exceed(excess, value, line, price, bends: Bends | None) -> None:
    """The maximum height of the kinks of a cell above the chord of `value`, into `excess`."""
    if bends is None:
        return
    reduceat = value[bends.left] - value[bends.right]
    reduceat *= bends.share
    reduceat -= value[bends.left]
    reduceat += line[bends.target]
    reduceat += bends.keep * price
    if bends.starts is not None:
        reduceat = np.maximum.reduceat(reduceat, bends.starts, axis=0)
    excess[bends.cells] = np.maximum(excess[bends.cells], reduceat)
