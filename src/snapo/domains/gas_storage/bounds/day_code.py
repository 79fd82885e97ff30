"""A day of a store in machine code, with the same bits as `day_grid.best_value` in NumPy.

The code works on a few columns at a time, so that their values stay in the fastest cache. For one
block of columns and one direction of flow, the scratch memory has these rows: the value after the
day minus the value of the gas, at each node; the maxima over 2, 4, 8 … consecutive nodes; and minus
infinity.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..references.day_terms import UnitPrices
from .reach import Bends, GridRows, ReachableLevels

if TYPE_CHECKING:
    from snapo.lanes.emit.code import Code
    from snapo.lanes.emit.module import Ref
    from snapo.lanes.machine.linked import Linked


WIDTH = 16  # columns at once; the last ones of a number of columns may be computed twice


class SideCode(NamedTuple):
    """One direction of flow; rows are those of the scratch memory.

    - `sizes` [3]: the number of rows, of maxima among the rows, and of bends.
    - `maxima` [maxima, 2]: the two rows of which each maximum is the larger.
    - `window` [n, 2]: the two rows of which the larger is the largest value at a node within reach.
    - `endpoints` [n, 4], `shares` [n, 2]: rows left and right of both limits of the reach, and the
      weight of the right one.
    - `bends` [bends, 3]: cell, next node, and the node where the full flow ends; `bend_numbers`
      [bends, 2]: share of the way to the right, and inventory without any flow.
    """

    sizes: np.ndarray
    maxima: np.ndarray
    window: np.ndarray
    endpoints: np.ndarray
    shares: np.ndarray
    bends: np.ndarray
    bend_numbers: np.ndarray


HEAD = ("value", "after", "goals", "keep", "cost", "excess")  # arrays of both directions
SIDE = ("price", "scratch", *SideCode._fields)
TABLE = (*HEAD, *(f"{side}_{name}" for side in ("buy", "sell") for name in SIDE))


@dataclass(frozen=True, eq=False)
class DayFlows:
    """Both directions of flow on a day, from `rows` nodes at its start to `size` nodes at its end.

    - `buy`, `sell`: the reach of each, with its bends if an upper value is computed.
    - `sides`: the same for the machine code, made when first needed.
    """

    rows: int
    size: int
    buy: ReachableLevels
    sell: ReachableLevels
    buy_bends: Bends | None
    sell_bends: Bends | None

    @cached_property
    def sides(self) -> list[SideCode]:
        parts = (self.buy, self.buy_bends), (self.sell, self.sell_bends)
        return [_side(*part, self.rows, self.size) for part in parts]


def best_value(
    flows: DayFlows,
    numbers: tuple[np.ndarray, np.ndarray, np.ndarray],
    prices: UnitPrices,
    after: np.ndarray,
    above: bool,
) -> np.ndarray:
    """See `day_grid.best_value`; `numbers`: the inventories of the nodes after the day, the
    inventories at the end without a flow, and the cost of holding them."""
    from snapo.lanes.machine.linked import address  # late: a case is checked without it

    columns = after.shape[1]
    value = np.empty((flows.rows, columns))
    arrays = [np.ascontiguousarray(x, float) for x in (after, *numbers)]
    arrays = [value, *arrays, np.empty((flows.rows + 1, WIDTH))]
    for side, price in zip(flows.sides, (prices.pay, prices.earn), strict=True):
        scratch = np.empty((int(side.sizes[0]), WIDTH))
        arrays += [np.ascontiguousarray(price, float), scratch, *side]
    table = np.array([address(x) for x in arrays], np.int64)
    _machine().functions["day"](address(table), flows.rows, flows.size, columns, int(above))
    return value


def serves(columns: int) -> bool:
    """Whether machine code can be made here and there are enough columns for it."""
    from snapo.lanes.machine.pipeline import available  # late, as above

    return columns >= WIDTH and available()


def _side(reach: ReachableLevels, bends: Bends | None, rows: int, nodes: int) -> SideCode:
    levels = 1 + max((k for k, *_ in reach.inside), default=0)
    counts = [max(nodes - (1 << k) + 1, 0) for k in range(levels)]
    starts = np.cumsum([0, *counts])
    pairs = [
        np.stack([np.arange(counts[k]) + starts[k - 1] + step for step in (0, 1 << (k - 1))], 1)
        for k in range(1, levels)
    ]
    nothing = int(starts[-1])  # the row of minus infinity
    window = np.full((rows, 2), nothing)
    for k, selected, first, last in reach.inside:
        window[selected, 0] = starts[k] + _numbers(first)
        window[selected, 1] = starts[k] + _numbers(last)
    endpoints, shares = np.repeat(window[:, :1], 4, axis=1), np.zeros((rows, 2))
    for i, (selected, left, right, share) in enumerate(reach.endpoints):
        endpoints[selected, 2 * i], endpoints[selected, 2 * i + 1] = _numbers(left), _numbers(right)
        shares[selected, i] = share[:, 0]
    bent, bend_numbers = np.zeros((0, 3), np.int64), np.zeros((0, 2))
    if bends is not None:
        bent = np.stack([_numbers(x) for x in (bends.left, bends.right, bends.target)], axis=1)
        bend_numbers = np.concatenate([bends.share, bends.keep], axis=1)
    integers = [
        np.ascontiguousarray(x, np.int64)
        for x in (
            [nothing + 1, nothing - nodes, len(bent)],
            np.concatenate([np.zeros((0, 2), int), *pairs]),
            window,
            endpoints,
            bent,
        )
    ]
    sizes, maxima, window, endpoints, bent = integers
    return SideCode(
        sizes, maxima, window, endpoints, shares, bent, np.ascontiguousarray(bend_numbers, float)
    )


def _numbers(rows: GridRows) -> np.ndarray:
    return np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows


@cache
def _machine() -> "Linked":
    from snapo.lanes.machine.code_cache import linked_code  # late, as above

    return linked_code(_text(), {"day": 4})


def _text() -> str:
    from snapo.lanes.emit.code import Code
    from snapo.lanes.emit.module import Module
    from snapo.lanes.machine.pipeline import host

    module = Module(WIDTH, host().register)
    code = Code(WIDTH, module)
    _Day(code).write()
    header = "define void @day(ptr %table, i64 %rows, i64 %goals, i64 %columns, i64 %above)"
    code.do("ret void")
    code.define(header)
    return module.text()


class _Day:
    """The instructions of one day."""

    def __init__(self, code: "Code"):
        self.code = code
        self.arrays = {
            name: code.raw(f"load ptr, ptr {code.pointer('%table', 8 * i)}, align 8")
            for i, name in enumerate(TABLE)
        }
        self.column = ""  # the first of the block

    def write(self) -> None:
        """Writes the code for all blocks of columns."""
        code = self.code
        more = code.index(f"add i64 %columns, {WIDTH - 1}")
        final = code.index(f"sub i64 %columns, {WIDTH}")
        with code.loop(code.index(f"sdiv i64 {more}, {WIDTH}")) as block:
            along = code.index(f"mul i64 {block.i}, {WIDTH}")
            over = code.index(f"icmp sgt i64 {along}, {final}")
            self.column = code.index(f"select i1 {over}, i64 {final}, i64 {along}")
            for side in ("buy", "sell"):
                self._lines(side)
                self._best(side)
            with code.branch(code.index("icmp ne i64 %above, 0")):
                self._raise()
            with code.loop("%rows") as row:
                cost = self._number("cost", row.i)
                self._set_row("value", row.i, code.sub(self._row("value", row.i), cost))

    def _lines(self, side: str) -> None:
        """The value minus the value of the gas, and the maxima of rows."""
        code, scratch = self.code, f"{side}_scratch"
        price = self._row(f"{side}_price", "0")
        with code.loop("%goals") as node:
            gas = code.mul(self._number("goals", node.i), price)
            self._set_scratch(scratch, node.i, code.sub(self._row("after", node.i), gas))
        with self._times(side, 1) as maximum:
            pair = [self._by_number(side, "maxima", maximum, i, 2) for i in (0, 1)]
            row = code.index(f"add i64 {maximum}, %goals")
            self._set_scratch(scratch, row, self._larger(*pair))
        last = code.index(f"sub i64 {self._integer(f'{side}_sizes', '0', 0, 3)}, 1")
        self._set_scratch(scratch, last, code.constant(-np.inf, "float64", WIDTH))

    def _best(self, side: str) -> None:
        """The best flow in one direction from each node."""
        code = self.code
        price = self._row(f"{side}_price", "0")
        with code.loop("%rows") as row:
            best = self._larger(*(self._by_number(side, "window", row.i, i, 2) for i in (0, 1)))
            for i in (0, 1):
                left, right = (
                    self._by_number(side, "endpoints", row.i, 2 * i + j, 4) for j in (0, 1)
                )
                share = self._number(f"{side}_shares", row.i, i, 2)
                there = code.add(code.mul(code.sub(right, left), share), left)
                best = self._larger(there, best)  # a row of nothing is not larger
            best = code.add(best, code.mul(self._number("keep", row.i), price))
            if side == "sell":
                best = self._larger(best, self._row("value", row.i))
            self._set_row("value", row.i, best)

    def _raise(self) -> None:
        """Raises each node by the larger gap of its two cells. Row i + 1 of the excess belongs to
        cell i; the first and the last row repeat those of the outer cells."""
        code = self.code
        zero, last = code.constant(0.0, "float64", WIDTH), code.index("sub i64 %rows, 1")
        with code.loop(code.index("add i64 %rows, 1")) as row:
            self._set_scratch("excess", row.i, zero)
        for side in ("buy", "sell"):
            price = self._row(f"{side}_price", "0")
            with self._times(side, 2) as bend:
                cell, next_one, met = (self._integer(f"{side}_bends", bend, i, 3) for i in range(3))
                share, keep = (self._number(f"{side}_bend_numbers", bend, i, 2) for i in (0, 1))
                left, right = self._row("value", cell), self._row("value", next_one)
                height = code.sub(code.mul(code.sub(left, right), share), left)
                height = code.add(height, self._scratch(f"{side}_scratch", met))
                height = code.add(height, code.mul(keep, price))
                row = code.index(f"add i64 {cell}, 1")
                self._set_scratch("excess", row, self._larger(height, self._scratch("excess", row)))
        self._set_scratch("excess", "0", self._scratch("excess", "1"))
        self._set_scratch("excess", "%rows", self._scratch("excess", last))
        with code.loop("%rows") as row:
            next_one = code.index(f"add i64 {row.i}, 1")
            gap = self._larger(self._scratch("excess", row.i), self._scratch("excess", next_one))
            self._set_row("value", row.i, code.add(self._row("value", row.i), gap))

    @contextmanager
    def _times(self, side: str, size: int) -> Iterator[str]:
        """A loop over the maxima (`size` 1) or the bends (`size` 2), of which there may be none;
        yields their number in turn."""
        code, count = self.code, self._integer(f"{side}_sizes", "0", size, 3)
        with code.branch(code.index(f"icmp sgt i64 {count}, 0")), code.loop(count) as loop:
            yield loop.i

    def _larger(self, a: "Ref", b: "Ref") -> "Ref":
        return self.code.select(self.code.compare("ogt", a, b), a, b)

    def _entry(self, name: str, row: str, i: int, width: int) -> str:
        first = self.code.index(f"mul i64 {row}, {8 * width}")
        return self.code.pointer(self.code.pointer(self.arrays[name], first), 8 * i)

    def _integer(self, name: str, row: str, i: int, width: int) -> str:
        return self.code.index(f"load i64, ptr {self._entry(name, row, i, width)}, align 8")

    def _number(self, name: str, row: str, i: int = 0, width: int = 1) -> "Ref":
        return self.code.load(self._entry(name, row, i, width), "float64", 1)

    def _place(self, name: str, row: str) -> str:
        """The address of the columns of this block in a row of all columns."""
        first = self.code.index(f"mul i64 {row}, %columns")
        number = self.code.index(f"add i64 {first}, {self.column}")
        return self.code.pointer(self.arrays[name], self.code.index(f"mul i64 {number}, 8"))

    def _row(self, name: str, row: str) -> "Ref":
        return self.code.load(self._place(name, row), "float64", WIDTH, align=8)

    def _set_row(self, name: str, row: str, x: "Ref") -> None:
        self.code.do(f"store {x.type} {x.text}, ptr {self._place(name, row)}, align 8")

    def _scratch(self, name: str, row: str) -> "Ref":
        return self.code.load(self._entry(name, row, 0, WIDTH), "float64", WIDTH, align=8)

    def _by_number(self, side: str, table: str, row: str, i: int, width: int) -> "Ref":
        """The row of scratch memory whose number is in a table."""
        return self._scratch(f"{side}_scratch", self._integer(f"{side}_{table}", row, i, width))

    def _set_scratch(self, name: str, row: str, x: "Ref") -> None:
        self.code.do(f"store {x.type} {x.text}, ptr {self._entry(name, row, 0, WIDTH)}, align 8")
