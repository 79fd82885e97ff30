"""The best move and volume from each node, in machine code with the same bits as a loop in NumPy.

A way is one volume of a move from one node. Its value is the money of the move, plus the volume
times the earnings of a unit, plus the value at its end, a weighted sum of the values at nodes. The
code works on a few columns at a time, so that their values stay in the fastest cache and the best
values so far in registers.
"""

from collections.abc import Callable
from functools import cache, cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..core.contract import ContractLayout
from .passages import Passages

if TYPE_CHECKING:
    from snapo.lanes.machine.linked import Linked

WIDTH = 16  # columns at once; the last ones of a number of columns may be computed twice
NOTHING = "0xFFF0000000000000"  # minus infinity


class Ways(NamedTuple):
    """All ways through one step in all modes, in the order of the nodes where they begin.

    - `first` [nodes + 1], `corner` [ways + 1]: the first way of each node, and the first corner of
      each way.
    - `move`, `flow`, `volume` [ways]: the move, flow and volume of each way; `node`, `weight`
      [corners]: the nodes where it ends, and their weights.
    """

    first: np.ndarray
    corner: np.ndarray
    move: np.ndarray
    flow: np.ndarray
    volume: np.ndarray
    node: np.ndarray
    weight: np.ndarray

    def best(self, cash: np.ndarray, fixed: np.ndarray, after: np.ndarray) -> np.ndarray:
        """[modes, nodes, columns] the best values; the arguments are those of `grid.best`."""
        from snapo.lanes.machine.linked import address  # late: a case is checked without it

        modes, _, columns = after.shape
        money = fixed if fixed.ndim > 1 else np.repeat(fixed[:, None], columns, axis=1)
        value = np.empty((len(self.first) - 1, columns))
        arrays = value, *(np.ascontiguousarray(x, float) for x in (after, cash, money)), *self
        table = np.array([address(x) for x in arrays], np.int64)
        _machine().functions["best"](address(table), len(value), columns)
        return value.reshape(modes, -1, columns)


class StepWays:
    """The ways of steps that have the same passages, computed when they are first needed."""

    def __init__(
        self, layout: ContractLayout, passages: Passages, before: list[int], after: list[int]
    ):
        self.parts = layout, passages, before, after

    @cached_property
    def best(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """See `Ways.best`."""
        return ways_of(*self.parts).best

    def serve(self, columns: int) -> bool:
        """Whether machine code is available for these ways and there are enough columns for it."""
        from snapo.lanes.machine.pipeline import available  # late, as above

        return columns >= WIDTH and bool(self.parts[0].flows) and available()


def ways_of(
    layout: ContractLayout, passages: Passages, before: list[int], after: list[int]
) -> Ways:
    """The ways of a step from its passages, with the numbers of nodes of each level."""
    source, target = (np.arange(np.prod(x, dtype=int)).reshape(x) for x in (before, after))
    starts, numbers, volumes, sizes, goals_of, weights_of = ([np.zeros(0, int)] for _ in range(6))
    for m, (move, of_move) in enumerate(zip(layout.every_move, passages)):
        start, goal = move.before * source.size, move.after * target.size
        for flow, volume, rows, goals, weights in of_move:
            if weights is None:
                start_nodes, goal_nodes = source[rows].reshape(-1), target[goals].reshape(1, -1)
                weights = np.ones(goal_nodes.shape)
            else:
                start_nodes, goal_nodes, weights = rows, goals, weights[:, :, 0]
            count = len(start_nodes)  # `numbers`: of the move and the flow, as one
            starts.append(start + start_nodes)
            numbers.append(np.full(count, m * len(layout.flows) + max(flow, 0)))
            volumes.append(np.full(count, float(volume)))
            sizes.append(np.full(count, len(goal_nodes)))
            goals_of.append(goal + goal_nodes.T.reshape(-1))
            weights_of.append(weights.T.reshape(-1))
    start, number, volume, size, goals, weights = map(
        np.concatenate, (starts, numbers, volumes, sizes, goals_of, weights_of)
    )
    order = np.argsort(start, kind="stable")
    first_corner = (np.cumsum(size) - size)[order]
    corner = np.cumsum([0, *size[order]])
    # The corners of all ways in their new order, one after the other.
    moved = np.arange(corner[-1]) + np.repeat(first_corner - corner[:-1], size[order])
    nodes = np.arange(len(layout.modes) * source.size + 1)
    return Ways(
        np.searchsorted(start[order], nodes).astype(np.int64),
        corner.astype(np.int64),
        *np.divmod(number[order].astype(np.int64), max(len(layout.flows), 1)),
        volume[order].astype(float),
        goals[moved].astype(np.int64),
        weights[moved].astype(float),
    )


@cache
def _machine() -> "Linked":
    from snapo.lanes.machine.code_cache import linked_code  # late, as above

    return linked_code(_text(), {"best": 2})


def _text() -> str:
    kind = f"<{WIDTH} x double>"
    fill = ", ".join([f"double {NOTHING}"] * WIDTH)
    names = ("value", "after", "cash", "money", *Ways._fields)
    arrays = "\n".join(
        f"  %{x}.at = getelementptr i64, ptr %table, i64 {i}\n  %{x} = load ptr, ptr %{x}.at"
        for i, x in enumerate(names)
    )

    def entry(name: str, array: str, number: str, of: str = "i64") -> str:
        return f"""  %{name}.at = getelementptr {of}, ptr %{array}, i64 %{number}
  %{name} = load {of}, ptr %{name}.at"""

    def row(name: str, array: str, number: str) -> str:
        return f"""  %{name}.row = mul i64 %{number}, %columns
  %{name}.first = add i64 %{name}.row, %column
  %{name}.at = getelementptr double, ptr %{array}, i64 %{name}.first"""

    def loaded(name: str, array: str, number: str) -> str:
        return f"{row(name, array, number)}\n  %{name} = load {kind}, ptr %{name}.at, align 8"

    def spread(name: str, number: str) -> str:
        return f"""  %{name}.one = insertelement {kind} poison, double %{number}, i32 0
  %{name} = shufflevector {kind} %{name}.one, {kind} poison, <{WIDTH} x i32> zeroinitializer"""

    return f"""define void @best(ptr %table, i64 %nodes, i64 %columns) {{
entry:
{arrays}
  %last = sub i64 %columns, {WIDTH}
  br label %block
block:
  %along = phi i64 [ 0, %entry ], [ %further, %block.end ]
  %over = icmp sgt i64 %along, %last
  %column = select i1 %over, i64 %last, i64 %along
  br label %begin
begin:
  %n = phi i64 [ 0, %block ], [ %n.next, %begin.end ]
  %n.next = add i64 %n, 1
{entry("w.first", "first", "n")}
{entry("w.last", "first", "n.next")}
  %some = icmp slt i64 %w.first, %w.last
  br i1 %some, label %way, label %begin.end
way:
  %w = phi i64 [ %w.first, %begin ], [ %w.next, %way.end ]
  %best = phi {kind} [ <{fill}>, %begin ], [ %better, %way.end ]
  %w.next = add i64 %w, 1
{entry("c.first", "corner", "w")}
{entry("c.last", "corner", "w.next")}
  br label %end
end:
  %c = phi i64 [ %c.first, %way ], [ %c.next, %end ]
  %sum = phi {kind} [ zeroinitializer, %way ], [ %more, %end ]
{entry("there", "node", "c")}
{loaded("reached", "after", "there")}
{entry("part", "weight", "c", "double")}
{spread("parts", "part")}
  %weighed = fmul {kind} %reached, %parts
  %more = fadd {kind} %sum, %weighed
  %c.next = add i64 %c, 1
  %ended = icmp sge i64 %c.next, %c.last
  br i1 %ended, label %way.end, label %end
way.end:
{entry("m", "move", "w")}
{loaded("fixed", "money", "m")}
{entry("f", "flow", "w")}
{loaded("unit", "cash", "f")}
{entry("much", "volume", "w", "double")}
{spread("volumes", "much")}
  %sold = fmul {kind} %volumes, %unit
  %earned = fadd {kind} %fixed, %sold
  %total = fadd {kind} %more, %earned
  %above = fcmp ogt {kind} %total, %best
  %better = select <{WIDTH} x i1> %above, {kind} %total, {kind} %best
  %w.done = icmp sge i64 %w.next, %w.last
  br i1 %w.done, label %begin.end, label %way
begin.end:
  %result = phi {kind} [ <{fill}>, %begin ], [ %better, %way.end ]
{row("result", "value", "n")}
  store {kind} %result, ptr %result.at, align 8
  %n.done = icmp sge i64 %n.next, %nodes
  br i1 %n.done, label %block.end, label %begin
block.end:
  %further = add i64 %along, {WIDTH}
  %done = icmp sge i64 %further, %columns
  br i1 %done, label %finish, label %block
finish:
  ret void
}}
"""
