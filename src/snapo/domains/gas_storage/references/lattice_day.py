"""One day of the inventory lattice: its grid, the best decisions on the grid, and their effect."""

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from .day_terms import (
    DayRates,
    FlowChoices,
    Interpolation,
    UnitPrices,
    cash,
    holding_cost,
    moves,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Which flows of a day are tried: the extremes (most, least, smallest), also the node where the
# value minus the price is greatest ("free"), or also every node ("every").
Volumes = Literal["extremes", "free", "every"]
HOLD, UP, DOWN, BUY_TO, SELL_TO, MOVE_TO = range(6)


def free_volumes(schedule, interpolation: Interpolation) -> Volumes:
    """The search for free volumes; with step ratchets the value jumps, so that every node is
    tried."""
    return "every" if interpolation == "step" and schedule.steps.levels.shape[-1] > 1 else "free"


class DayDecisions(NamedTuple):
    """The best decisions of one day, and the nodes to which they lead.

    - `inventory`: [n] the grid at the start of the day; `nodes`: [m] the grid at its end.
    - `choice`: [n, columns] HOLD (the flow nearest to zero), UP and DOWN (the largest and the
      smallest net flow), BUY_TO or SELL_TO (a flow to the node of the column), MOVE_TO (a flow to a
      separate node).
    - `today`: the inventories at the end of the day for the first three; `buy_to`, `sell_to`
      [columns] and `move_to` [n, columns]: the nodes of the others.
    """

    inventory: np.ndarray
    nodes: np.ndarray
    choice: np.ndarray
    today: FlowChoices
    buy_to: np.ndarray
    sell_to: np.ndarray
    move_to: np.ndarray | None


class LatticeFlow(NamedTuple):
    """The expected volumes of one day by column [columns], and the probabilities after it [m,
    columns]."""

    injected: np.ndarray
    withdrawn: np.ndarray
    weight: np.ndarray


def inventory_nodes(low: float, high: float, spacing: float, levels: np.ndarray) -> np.ndarray:
    """The multiples of the spacing inside [low, high], with both ends and the `levels` between
    them."""
    if high - low <= 1e-9 * spacing:
        return np.array([low])
    inner = np.arange(np.ceil(low / spacing), np.floor(high / spacing) + 1) * spacing
    inner = inner[(inner > low + spacing / 3) & (inner < high - spacing / 3)]
    levels = levels[(levels > low + 1e-9 * spacing) & (levels < high - 1e-9 * spacing)]
    nodes = np.unique(np.concatenate([[low], inner, levels, [high]]))
    apart = np.append(True, np.diff(nodes) > 1e-9 * spacing)
    return nodes[apart]


def decide(
    schedule,
    day_rates: DayRates,
    t: int,
    prices: UnitPrices,
    inventory: np.ndarray,
    nodes: np.ndarray,
    after: np.ndarray,
    volumes: Volumes,
) -> tuple[DayDecisions, np.ndarray]:
    """The best decision at each start-of-day inventory [n] and column, and the value [n, columns].

    `after` [m, columns] is the value at the end of the day on `nodes` [m]. With free volumes, the
    node with the largest value minus price is a target if it is within reach. If `after` is concave
    in the inventory, no other target is needed.
    """
    today = moves(schedule, day_rates, t, inventory)
    best = np.full((len(inventory), after.shape[1]), -np.inf)
    choice = np.zeros(best.shape, np.int8)

    def offer(code: int, value: np.ndarray, where: np.ndarray | bool = True):
        better = (value > best) & where
        np.copyto(best, value, where=better)
        np.copyto(choice, np.int8(code), where=better)

    for code, target in ((HOLD, today.hold), (UP, today.up), (DOWN, today.down)):
        net = target - today.keep
        offer(code, interpolation_matrix(nodes, target) @ after + cash(prices, net))
    peaks = []
    for code, price in ((BUY_TO, prices.pay), (SELL_TO, prices.earn)):
        net_value = after - nodes[:, None] * price
        node = np.argmax(net_value, axis=0)
        peaks.append(node)
        if volumes != "extremes":
            floor, ceiling = (today.hold, today.up) if code == BUY_TO else (today.down, today.hold)
            target = nodes[node]
            within = (target > floor[:, None]) & (target < ceiling[:, None])
            peak = net_value[node, np.arange(len(node))]
            offer(code, peak + today.keep[:, None] * price, within)
    move_to = None
    if volumes == "every":
        move_to = _try_every_node(today, prices, nodes, after, best, choice)
    value = best - holding_cost(schedule, t, inventory)[:, None]
    return DayDecisions(inventory, nodes, choice, today, peaks[0], peaks[1], move_to), value


def _try_every_node(
    today: FlowChoices, prices: UnitPrices, nodes, after, best, choice
) -> np.ndarray:
    """Improves `best` and `choice` [n, columns] in place; returns the node of each MOVE_TO."""
    move_to = np.zeros(best.shape, np.int16)
    for j, node in enumerate(nodes):
        rows = np.flatnonzero((today.down < node) & (node < today.up))
        if len(rows):
            value = after[j] + cash(prices, node - today.keep[rows])
            better = value > best[rows]
            best[rows] = np.where(better, value, best[rows])
            choice[rows] = np.where(better, MOVE_TO, choice[rows])
            move_to[rows] = np.where(better, j, move_to[rows])
    return move_to


def follow(day: DayDecisions, weight: np.ndarray) -> LatticeFlow:
    """Moves probabilities [n, columns] from the start of the day to its end."""
    after = np.zeros((len(day.nodes), weight.shape[1]))
    injected, withdrawn = np.zeros((2, weight.shape[1]))
    today, columns = day.today, np.arange(weight.shape[1])
    for code, target in ((HOLD, today.hold), (UP, today.up), (DOWN, today.down)):
        moved = np.where(day.choice == code, weight, 0.0)
        net = target - today.keep
        injected += np.maximum(net, 0.0) @ moved
        withdrawn += np.maximum(-net, 0.0) @ moved
        after += interpolation_matrix(day.nodes, target).T @ moved
    for code, node in ((BUY_TO, day.buy_to), (SELL_TO, day.sell_to)):
        moved = np.where(day.choice == code, weight, 0.0)
        arrived = moved.sum(axis=0)
        net = day.nodes[node] * arrived - today.keep @ moved
        injected, withdrawn = (
            (injected + net, withdrawn) if code == BUY_TO else (injected, withdrawn - net)
        )
        after[node, columns] += arrived
    if day.move_to is not None:
        row, column = np.nonzero((day.choice == MOVE_TO) & (weight != 0))
        node, moved = day.move_to[row, column], weight[row, column]
        net = (day.nodes[node] - today.keep[row]) * moved
        injected += np.bincount(column, np.maximum(net, 0.0), weight.shape[1])
        withdrawn += np.bincount(column, np.maximum(-net, 0.0), weight.shape[1])
        np.add.at(after, (node, column), moved)
    return LatticeFlow(injected, withdrawn, after)


def interpolation_matrix(nodes: np.ndarray, points: np.ndarray) -> "csr_array":
    """The sparse matrix [n, m] of the linear interpolation from rising nodes [m] to points [n],
    constant outside the nodes. Linear interpolation preserves the order of values, and can only
    lower a concave value.
    """
    from scipy.sparse import csr_array  # late: a case is checked without it

    count, size = len(points), len(nodes)
    if size == 1:
        return csr_array(np.ones((count, 1)))
    points = np.minimum(np.maximum(points, nodes[0]), nodes[-1])
    left = np.searchsorted(nodes[1:-1], points, side="right")
    share = (points - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights, columns = np.empty((count, 2)), np.empty((count, 2), np.int32)
    weights[:, 0], weights[:, 1] = 1 - share, share
    columns[:, 0], columns[:, 1] = left, left + 1
    # SciPy uses indices of 32 bits unchanged, and searches longer ones for their largest.
    rows = np.arange(0, 2 * count + 1, 2, dtype=np.int32)
    return csr_array((weights.ravel(), columns.ravel(), rows), (count, size))
