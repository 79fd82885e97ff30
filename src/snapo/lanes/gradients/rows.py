"""Gradients summed over steps: outer products and summands wait in rows until they are added up."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..emit.code import Code
from ..emit.module import Module, Ref
from ..emit.storage import ArrayPlace, Layout, Shared, Small
from ..emit.values import EmittedValues
from ..program.cut import Leaf
from ..program.program import BIG, Op, Program, ProgramValue
from .adding import across, add, add_number, add_row, add_rows, pick, ranges


@dataclass(eq=False)
class Outer:
    """A term of a matrix's gradient: the product of two vectors, summed over paths and steps."""

    rows: ProgramValue
    columns: ProgramValue


def outer_terms(program: Program, gradient: ProgramValue) -> tuple[list[Outer], list[ProgramValue]]:
    """Splits a gradient that will be summed over paths into outer products and everything else.

    It traces them through sums and transpositions; the rest must be computed path by path.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    terms: list[Outer] = []
    rest: list[ProgramValue] = []

    def visit(value: ProgramValue) -> None:
        op = maker.get(value)
        if op is not None and op.name == "add_any":
            products, first = len(terms), len(rest)
            for v in op.inputs:
                visit(v)
            if len(terms) == products:  # no product inside: the sum is less to keep than its parts
                rest[first:] = [value]
        elif op is not None and op.name == "reshape":
            visit(op.inputs[0])
        elif op is not None and op.name == "transpose" and op.params["permutation"] == (1, 0):
            source = maker.get(op.inputs[0])
            if source is None or not is_outer(source) or len(source.inputs[0].shape) != 1:
                rest.append(value)
            else:
                terms.append(Outer(*reversed(source.inputs)))
        elif op is not None and is_outer(op):
            terms.append(Outer(*op.inputs))
        elif value.constant is None or np.any(value.constant):
            rest.append(value)

    visit(gradient)
    return terms, rest


def is_outer(op: Op) -> bool:
    """A dot product that contracts nothing, of two arrays that differ between paths."""
    if op.name != "dot_general" or not all(v.path for v in op.inputs):
        return False
    (contract, _), (batch, _) = op.params["dimension_numbers"]
    return not contract and not batch and op.outputs[0].size > BIG


@dataclass(eq=False)
class GradientRule:
    """One shared array's gradient: outer products, and values to be summed element by element."""

    leaf: Leaf
    terms: list[Outer]
    rest: list[ProgramValue]

    @property
    def factors(self) -> list[ProgramValue]:
        return [v for t in self.terms for v in (t.rows, t.columns)]


@dataclass(eq=False)
class Gradients:
    """Gradients summed over the whole call's steps, and those of a step's numbers."""

    items: list[GradientRule]

    def required(self) -> list[ProgramValue]:
        """All quantities that the reverse sweep must compute."""
        return [v for g in self.items for v in g.rest] + [v for g in self.items for v in g.factors]

    def stored(self, later: set[ProgramValue]) -> set[ProgramValue]:
        """Factors that the forward sweep must store; `later` belongs to the reverse sweep."""
        return {v for g in self.items for v in g.factors if v not in later}


def plan(program: Program, leaves: list[Leaf], outputs: list[ProgramValue]) -> Gradients:
    """The accumulation of each gradient."""
    pairs = zip(leaves, outputs)
    return Gradients([GradientRule(leaf, *outer_terms(program, value)) for leaf, value in pairs])


PANEL = 96  # columns of a product that are gone through for all rows before the next ones


def product_function(module: Module, sizes: tuple[int, int], dtype: str, along: bool) -> str:
    """The function that adds sum over s of a[s, i] b[s, j] to a float64 matrix.

    With `along` it also adds the sum of a[s, i] to a vector: one more column, of ones.
    """
    rows, columns = sizes
    name = f"product_{dtype}_{rows}_{columns}{'_along' if along else ''}"
    if not module.first(name):
        return name
    width = min(module.lanes, module.register // np.dtype(dtype).itemsize)
    code = Code(module.lanes, module)
    tile = (4, 3) if module.few else (4, 4)

    def panel(start: str, wide: int) -> None:
        last = along and start == str(columns - wide)

        def tall(i: str, height: int) -> None:
            def block(j: str, breadth: int) -> None:
                at = code.index(f"add nsw i64 {start}, {j}")
                ones = last and j == str(wide + 1 - breadth)
                shape = height, breadth - ones, ones
                _product_tile(code, columns, (i, at), shape, width, dtype)

            ranges(code, wide + last, tile[1], block, apart=last)

        ranges(code, rows, tile[0], tall)

    ranges(code, columns, PANEL, panel, apart=along)
    code.do("ret void")
    header = (
        f"define internal void @{name}(ptr noalias %a, i64 %sa, ptr noalias %b, i64 %sb, "
        "i64 %count, ptr noalias %sum, ptr noalias %along) noinline nounwind"
    )
    code.define(header)
    return name


def _product_tile(code: Code, columns: int, first, shape, width: int, dtype: str) -> None:
    (i, j), (height, breadth, ones) = first, shape
    item = np.dtype(dtype).itemsize
    unit, part = code.lanes * item, width * item
    a = code.pointer("%a", code.index(f"mul nsw i64 {i}, {unit}"))
    b = code.pointer("%b", code.index(f"mul nsw i64 {j}, {unit}"))
    zero = code.constant(0.0, dtype, width)
    with code.loop("%count", (zero,) * (height * (breadth + ones))) as loop:
        p = code.pointer(a, code.index(f"mul nsw i64 {loop.i}, %sa"))
        q = code.pointer(b, code.index(f"mul nsw i64 {loop.i}, %sb"))
        sums = list(loop.carried)
        for v in range(code.lanes // width):
            at = v * part
            x = [code.load(code.pointer(p, r * unit + at), dtype, width) for r in range(height)]
            y = [code.load(code.pointer(q, c * unit + at), dtype, width) for c in range(breadth)]
            pairs = [(x[r], y[c]) for r in range(height) for c in range(breadth)]
            products = [code.fma(*pair, total) for pair, total in zip(pairs, sums)]
            local = [code.op("fadd", one, total) for one, total in zip(x, sums[len(pairs) :])]
            sums = products + local
        loop.results = sums
    totals = across(code, loop.results, width)
    row = code.index(f"mul nsw i64 {i}, {8 * columns}")
    target = code.pointer(code.pointer("%sum", row), code.index(f"shl i64 {j}, 3"))
    for r in range(height if breadth else 0):
        x = pick(code, totals, [r * breadth + c for c in range(breadth)], width)
        add_row(code, code.pointer(target, 8 * r * columns), x, range(breadth))
    if ones:
        x = pick(code, totals, [height * breadth + r for r in range(height)], width)
        add_row(code, code.pointer("%along", code.index(f"shl i64 {i}, 3")), x, range(height))


LONGEST = 32  # steps that wait before they are gathered
WAITING = 1024 * 1024  # bytes that they may take, so that they stay in cache


class Rows:
    """The waiting rows: where factors and summands of several steps lie."""

    def __init__(
        self,
        gradients: Gradients,
        tape: Layout,
        taped: list[ProgramValue],
        lanes: int,
        stepwise: bool,
    ):
        self.gradients, self.tape = gradients, tape
        self.taped = set(taped)
        self.layout = Layout(lanes)
        for g in gradients.items:
            for value in [*g.rest, *g.factors]:
                if value not in self.taped and value not in self.layout.fields:
                    self.layout.add(value, value.shape, value.dtype)
        self.fields: dict[Any, Any] = self.layout.fields
        self.steps = 1
        while stepwise and self.steps < LONGEST and 2 * self.steps * self.layout.stride <= WAITING:
            self.steps *= 2
        self.bytes = self.steps * self.layout.stride

    def row(self, code: Code, chunk: str, slot: str) -> str:
        return code.pointer(chunk, code.index(f"mul nsw i64 {slot}, {self.layout.stride}"))

    def homes(self, row: str) -> dict[ProgramValue, ArrayPlace]:
        return {value: self.layout.address(value, row) for value in self.fields}

    def address(self, value: ProgramValue, tape_row: str, chunk_row: str) -> tuple[ArrayPlace, str]:
        """The place of a value, and the distance to the next step's."""
        if value in self.taped:
            return self.tape.address(value, tape_row), "%stride"
        return self.layout.address(value, chunk_row), str(self.layout.stride)

    def gather(self, code: Code, sums: Shared, tape_row: str, chunk_row: str, count: str) -> None:
        """Adds up the stored steps of all gradients of the whole call.

        A vector without an outer product (a bias) is summed with a product whose rows it equals.
        """
        alone: dict[ProgramValue, list[ArrayPlace]] = {}
        products: list[tuple[Outer, ArrayPlace]] = []
        for g in self.gradients.items:
            if sums.of_call(g.leaf):
                target = sums.address(g.leaf)
                products += [(t, target) for t in g.terms]
                for value in g.rest:
                    alone.setdefault(value, []).append(target)
        for t, target in products:
            riding = alone.get(t.rows)
            along = riding.pop() if riding else None
            self.product(code, t, target, tape_row, chunk_row, count, along)
        for value, targets in alone.items():
            position, stride = self.address(value, tape_row, chunk_row)
            for target in targets:
                add_rows(code, position, stride, count, target)

    def product(
        self,
        code: Code,
        t: Outer,
        target: ArrayPlace,
        tape_row: str,
        chunk_row: str,
        count: str,
        along: ArrayPlace | None = None,
    ) -> None:
        """Adds the sum over steps of rows x columns to the target, and that of the rows to
        `along`."""
        a, stride_a = self.address(t.rows, tape_row, chunk_row)
        b, stride_b = self.address(t.columns, tape_row, chunk_row)
        sizes = t.rows.size, t.columns.size
        name = product_function(code.module, sizes, t.rows.dtype.name, along is not None)
        p, q = code.pointer(a.base, a.offset), code.pointer(b.base, b.offset)
        r = code.pointer(target.base, target.offset)
        local = "null" if along is None else code.pointer(along.base, along.offset)
        code.do(
            f"call void @{name}(ptr {p}, i64 {stride_a}, ptr {q}, i64 {stride_b}, "
            f"i64 {count}, ptr {r}, ptr {local})"
        )


def accumulate(
    values: EmittedValues, rows: Rows, sums: Shared, tape_row: str, chunk_row: str
) -> None:
    """Adds up the gradients with respect to this step's numbers."""
    singles: list[tuple[ArrayPlace, Ref]] = []
    for g in rows.gradients.items:
        if sums.of_call(g.leaf):
            continue
        target = sums.address(g.leaf)
        for t in g.terms:
            rows.product(values.code, t, target, tape_row, chunk_row, "1")
        for value in g.rest:
            available = values.held(value)
            if value.size <= BIG and isinstance(available, Small):
                singles += [(target.at(p), available.items[p]) for p in np.ndindex(*value.shape)]
            else:
                add(values, value, target)
    add_together(
        values.code, [(location, x) for location, x in singles if x.lanes == values.code.lanes]
    )
    for position, x in singles:
        if x.lanes != values.code.lanes:
            add_number(values.code, position, [], x)


def add_together(code: Code, singles: list[tuple[ArrayPlace, Ref]]) -> None:
    """Adds sums over lanes to float64 memory: a register's lanes of one become lanes of many."""
    singles = sorted(singles, key=lambda pair: (pair[0].base, pair[0].offset))
    if not singles:
        return
    width = code.module.register // np.dtype(singles[0][1].dtype).itemsize
    for start in range(0, len(singles), width):
        group = singles[start : start + width]
        vectors = []
        for _, x in group:
            parts = [code.part(x, k, width) for k in range(x.lanes // width)]
            while len(parts) > 1:
                parts = [code.op("fadd", *parts[k : k + 2]) for k in range(0, len(parts), 2)]
            vectors += parts
        (sums,) = across(code, vectors, width)
        for first, count in _neighbours([location for location, _ in group]):
            position = group[first][0]
            add_row(
                code,
                code.pointer(position.base, position.offset),
                sums,
                range(first, first + count),
            )


def _neighbours(positions: list[ArrayPlace]) -> list[tuple[int, int]]:
    """(first, how many) of numbers that lie side by side in memory."""
    runs = [[0, 1]]
    for i in range(1, len(positions)):
        before, position = positions[i - 1], positions[i]
        if position.base == before.base and position.offset == before.offset + position.unit:
            runs[-1][1] += 1
        else:
            runs.append([i, 1])
    return [(first, count) for first, count in runs]
