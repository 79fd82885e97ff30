"""One day of a store on a grid of inventories: the reach of each start, and the best flows.

The grid does not depend on prices: all paths share it. Positions at the end of the day are counted
in nodes of the grid at the end of the day. The value after the day is linear between nodes. The
best flow to a node or to an end of the reach is then exact at every start-of-day node. Between two
nodes the value is convex except at its bends (`DayFlows.buy_bends`). If both nodes are raised by
the gap at the bends, the line between them is an upper bound.
"""

from typing import NamedTuple

import numpy as np

from ..references.breakpoints import breakpoints
from ..references.day_terms import (
    POINT,
    DayRates,
    FlowChoices,
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
from .day_code import DayFlows, serves
from .reach import ON_NODE, Bends, ReachableLevels, reach
from .reach import bends as bends_of

BENDS = 0.5  # most nodes at bends of the intrinsic value, of the regular ones
SLIGHT = 1e-3  # bends below this part of the sharpest one are left out
NEAR = 0.02  # in spacings: nodes are not nearer to one another than this


class DayGrid(NamedTuple):
    """A decision day between two grids.

    - `nodes` [n], `after` [m]: the inventories of the grids at its start and at its end; `keep` [n]
      and `cost` [n]: the inventory at the end without a flow, and the present value of the cost of
      holding it.
    - `flows`: the inventories that buying and selling can reach.
    """

    nodes: np.ndarray
    after: np.ndarray
    keep: np.ndarray
    cost: np.ndarray
    flows: DayFlows


def day_grids(
    schedule, interpolation: Interpolation, inventories: int, bends: bool = True
) -> list[DayGrid]:
    """The grids of all T days, with nodes between which the value of the best flow is linear, if
    such nodes exist. Without `bends` the grids are for values of the best flow, not for upper
    bounds. They contain only inventories that can be reached from the present inventory. See
    `breakpoints` of the references for contracts with constant rates. For other contracts there are
    `inventories` points from 0 to the largest inventory. Ratchet rows are nodes, and so are the
    inventories where the intrinsic value bends most: inventories that can just be emptied or filled
    in time have a bend at all prices, and a bend between nodes causes the largest error.
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
    return days_between(schedule, day_rates, nodes, bends)


def largest_rate(schedule) -> float:
    """The largest volume that may flow on a day."""
    steps = schedule.steps
    return float(max(np.max(steps.injection_rate), np.max(steps.withdrawal_rate)))


def spacing_of(schedule, inventories: int, widest: float) -> float:
    """The spacing of the regular nodes: if possible a divisor of the largest flow, so that this
    flow ends on a node.

    `widest`: the widest interval of inventories that can be reached from the present inventory.
    """
    spacing, rate = widest / (inventories - 1), largest_rate(schedule)
    parts = round(rate / spacing) if spacing > 0 else 0
    return float(rate / parts) if parts else max(spacing, POINT * volume_scale(schedule))


def _bent(line: PiecewiseLine, maximum: int) -> np.ndarray:
    """The inner breakpoints of a line with the largest kinks, at most `maximum`."""
    if len(line.at) < 3:
        return np.zeros(0)
    change = np.abs(np.diff(np.diff(line.value) / np.diff(line.at)))
    selected = np.argsort(-change, kind="stable")[:maximum]
    return np.sort(line.at[1:-1][selected[change[selected] > SLIGHT * change.max()]])


def _joined(regular: np.ndarray, bent: np.ndarray, spacing: float, levels) -> np.ndarray:
    """The regular nodes, in which a node near a bend is replaced by the bend; the ends and the
    ratchet rows stay."""
    bent = bent[(bent > regular[0] + NEAR * spacing) & (bent < regular[-1] - NEAR * spacing)]
    fixed = np.concatenate([regular[[0, -1]], levels])
    bent = bent[np.abs(bent[:, None] - fixed).min(axis=1) > NEAR * spacing]
    bent = bent[np.append(True, np.diff(bent) > NEAR * spacing)[: len(bent)]]
    if not len(bent):
        return regular
    near = np.abs(regular[:, None] - bent[None, :]).min(axis=1) < spacing / 3
    return np.union1d(regular[~near | np.isin(regular, fixed)], bent)


def days_between(
    schedule, day_rates: list[DayRates], nodes: list[np.ndarray], bends: bool
) -> list[DayGrid]:
    """The T days between T + 1 grids; days with equal moves share their flows."""
    flows: dict[tuple[bytes, ...], DayFlows] = {}
    days = []
    for t in range(len(day_rates)):
        grids = nodes[t], nodes[t + 1]
        possible = moves(schedule, day_rates[t], t, nodes[t])
        reached = flow_ends(schedule, day_rates[t], t, nodes[t]) if bends else None
        key = tuple(x.tobytes() for x in (*grids, *possible, *(reached or ())))
        if key not in flows:
            bent = bends_of(schedule, reached, *grids) if reached else (None, None)
            flows[key] = _flows(possible, *grids, ON_NODE * volume_scale(schedule), bent)
        cost = holding_cost(schedule, t, nodes[t])
        days.append(DayGrid(*grids, possible.keep, cost, flows[key]))
    return days


def _flows(
    possible: FlowChoices,
    nodes: np.ndarray,
    after: np.ndarray,
    near: float,
    bent: tuple[Bends | None, Bends | None],
) -> DayFlows:
    keep, down, _, up = possible
    buy = reach(after, np.minimum(np.maximum(down, keep), up), up, up >= keep - near)
    sell = reach(after, down, np.maximum(np.minimum(up, keep), down), down <= keep + near)
    return DayFlows(len(nodes), len(after), buy, sell, *bent)


def best_value(day: DayGrid, prices: UnitPrices, after: np.ndarray, above: bool) -> np.ndarray:
    """The value at the start of the day [n, columns] of the best flow, computed from the value at
    its end.

    **Arguments:**

    - `prices`: the present values of a unit bought and of a unit sold, each [columns].
    - `after` [m, columns]: the value on the nodes at the end of the day, linear between them.
    - `above`: whether the result, linear between nodes, is an upper bound on the value of the best
      flow at every inventory; otherwise it equals that value at the nodes, and may be below it
      between them.
    """
    if serves(after.shape[1]):
        return day_code.best_value(day.flows, day[1:4], prices, after, above)
    keep, flows = day.keep[:, None], day.flows
    buying = _less(after, day.after, prices.pay)
    selling = _less(after, day.after, prices.earn)
    value = _best_within(buying, flows.buy, len(keep))
    value += keep * prices.pay
    other = _best_within(selling, flows.sell, len(keep))
    other += keep * prices.earn
    np.maximum(value, other, out=value)
    if above:
        excess = np.zeros((len(keep) - 1, after.shape[1]))
        _exceed(excess, value, buying, prices.pay, flows.buy_bends)
        _exceed(excess, value, selling, prices.earn, flows.sell_bends)
        # A node serves two cells, and is raised by the larger gap of the two.
        if len(excess):
            value[0] += excess[0]
            value[-1] += excess[-1]
            value[1:-1] += np.maximum(excess[:-1], excess[1:])
    if day.cost.any():
        value -= day.cost[:, None]
    return value


def _less(after: np.ndarray, nodes: np.ndarray, price: np.ndarray) -> np.ndarray:
    """[m, columns] the value after the day minus the value of the gas at a price."""
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
    """Writes into `excess` the maximum height of the kinks of each cell above the chord of
    `value`."""
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
