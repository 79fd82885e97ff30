"""Gradients of what all paths share: sums over lanes, steps and blocks, kept in float64.

A matrix's gradient is a sum of outer products. Adding each to memory would cost a load and a store
per multiply-add, so both factors of some tens of steps are kept and multiplied as small matrices,
tile by tile in registers; only then are the lanes added up. Vectors wait in the same rows.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .body import Body
from .code import Code, Ref
from .passes import BIG, Outer, outer_terms
from .program import Program, Value
from .storage import Layout, Place, Small
from .trace import Leaf

LONGEST = 32  # steps that wait before they are gathered
WAITING = 1024 * 1024  # bytes that they may take, so that they stay in cache
PANEL = 96  # columns of a product that are gone through for all rows before the next ones


@dataclass(eq=False)
class Gradient:
    """One shared array's gradient: outer products, and values to be summed element by element."""

    leaf: Leaf
    terms: list[Outer]
    rest: list[Value]


@dataclass(eq=False)
class Gradients:
    """Those summed over the whole call's steps, and those of a step's own numbers."""

    items: list[Gradient] = field(default_factory=list)

    def wanted(self, later: set[Value]) -> list[Value]:
        """Everything the reverse sweep must bring about."""
        values = [v for g in self.items for v in g.rest]
        return values + [v for g in self.items for t in g.terms for v in (t.rows, t.columns)]

    def kept(self, later: set[Value]) -> set[Value]:
        """Factors that the forward sweep must store."""
        return {
            v for g in self.items for t in g.terms for v in (t.rows, t.columns) if v not in later
        }


def plan(
    program: Program, later: set[Value], leaves: list[Leaf], outputs: list[Value]
) -> Gradients:
    """How each gradient is brought together."""
    result = Gradients()
    for leaf, value in zip(leaves, outputs):
        terms, rest = outer_terms(program, value)
        result.items.append(Gradient(leaf, terms, rest))
    return result


class Rows:
    """The waiting rows: where factors and summands of several steps lie."""

    def __init__(
        self, gradients: Gradients, tape: Layout, taped: list[Value], code: Code, stepwise: bool
    ):
        self.gradients, self.tape = gradients, tape
        self.taped = set(taped)
        self.layout = Layout(code.lanes)
        for g in gradients.items:
            for value in [*g.rest, *(v for t in g.terms for v in (t.rows, t.columns))]:
                if value not in self.taped and value not in self.layout.fields:
                    self.layout.add(value, value.shape, value.dtype)
        self.fields: dict[Any, Any] = self.layout.fields
        self.steps = 1
        while stepwise and self.steps < LONGEST and 2 * self.steps * self.layout.stride <= WAITING:
            self.steps *= 2
        self.bytes = self.steps * self.layout.stride

    def row(self, code: Code, chunk: str, slot: str) -> str:
        return code.pointer(chunk, code.index(f"mul nsw i64 {slot}, {self.layout.stride}"))

    def homes(self, row: str) -> dict[Value, Place]:
        return {value: self.layout.place(value, row) for value in self.fields}

    def place(self, value: Value, tape_row: str, chunk_row: str) -> tuple[Place, str]:
        """Where a value lies, and the distance to the next step's."""
        if value in self.taped:
            return self.tape.place(value, tape_row), "%stride"
        return self.layout.place(value, chunk_row), str(self.layout.stride)

    def gather(
        self, code: Code, owner, calls: str, tape_row: str, chunk_row: str, count: str
    ) -> None:
        """Sums over the waiting steps, of what belongs to the whole call.

        What is summed alone (a bias) rides along where it is also a product's rows.
        """
        alone: dict[Value, list[Place]] = {}
        products: list[tuple[Outer, Place]] = []
        for g in self.gradients.items:
            if g.leaf in owner.layouts["call_sums"].fields:
                target = owner.sums(g.leaf, calls, None)
                products += [(t, target) for t in g.terms]
                for value in g.rest:
                    alone.setdefault(value, []).append(target)
        for t, target in products:
            riding = alone.get(t.rows)
            along = riding.pop() if riding else None
            self.product(code, t, target, tape_row, chunk_row, count, along)
        for value, targets in alone.items():
            place, stride = self.place(value, tape_row, chunk_row)
            for target in targets:
                add_rows(code, place, stride, count, target)

    def product(
        self,
        code: Code,
        t: Outer,
        target: Place,
        tape_row: str,
        chunk_row: str,
        count: str,
        along: Place | None = None,
    ) -> None:
        """Adds the sum over steps of rows x columns to the target, that of the rows to `along`."""
        a, stride_a = self.place(t.rows, tape_row, chunk_row)
        b, stride_b = self.place(t.columns, tape_row, chunk_row)
        sizes = t.rows.size, t.columns.size
        name = product_function(code.module, sizes, t.rows.dtype.name, along is not None)
        p, q = code.pointer(a.base, a.offset), code.pointer(b.base, b.offset)
        r = code.pointer(target.base, target.offset)
        own = "null" if along is None else code.pointer(along.base, along.offset)
        code.do(
            f"call void @{name}(ptr {p}, i64 {stride_a}, ptr {q}, i64 {stride_b}, "
            f"i64 {count}, ptr {r}, ptr {own})"
        )


def accumulate(
    body: Body, rows: Rows, owner, calls: str, step_row: str | None, tape_row, chunk_row
) -> None:
    """Adds what belongs to this step's own numbers."""
    singles: list[tuple[Place, Ref]] = []
    for g in rows.gradients.items:
        if g.leaf in owner.layouts["call_sums"].fields:
            continue
        target = owner.sums(g.leaf, calls, step_row)
        for t in g.terms:
            rows.product(body.code, t, target, tape_row, chunk_row, "1")
        for value in g.rest:
            known = body.where.get(value)
            if value.size <= BIG and isinstance(known, Small):
                singles += [(target.at(p), known.items[p]) for p in np.ndindex(*value.shape)]
            else:
                add(body, value, target)
    add_together(body.code, [(place, x) for place, x in singles if x.lanes == body.code.lanes])
    for place, x in singles:
        if x.lanes != body.code.lanes:
            _add(body.code, place, [], x)


def add_together(code: Code, singles: list[tuple[Place, Ref]]) -> None:
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
        for first, count in _neighbours([place for place, _ in group]):
            place = group[first][0]
            _add_row(
                code, code.pointer(place.base, place.offset), sums, range(first, first + count)
            )


def _neighbours(places: list[Place]) -> list[tuple[int, int]]:
    """(first, how many) of numbers that lie side by side in memory."""
    runs = [[0, 1]]
    for i in range(1, len(places)):
        before, place = places[i - 1], places[i]
        if place.base == before.base and place.offset == before.offset + place.unit:
            runs[-1][1] += 1
        else:
            runs.append([i, 1])
    return [(first, count) for first, count in runs]


def _add_row(code: Code, at: str, sums: Ref, lanes: range) -> None:
    """Adds some lanes to float64 numbers that lie side by side."""
    x = _shuffle(code, sums, sums, list(lanes))
    wide = x if x.dtype == "float64" else code.convert("fpext", x, "float64")
    old = Ref(code.raw(f"load {wide.type}, ptr {at}, align 8"), "float64", wide.lanes)
    new = code.op("fadd", old, wide)
    code.do(f"store {new.type} {new.text}, ptr {at}, align 8")


def add(body: Body, value: Value, target: Place) -> None:
    """Adds a value, summed over lanes, to float64 memory of the same shape."""
    from .body import fetch, nest

    if value.constant is not None and not np.any(value.constant):
        return
    code, known = body.code, body.get(value)
    if isinstance(known, Small) and (value.size <= BIG or known.uniform is None):
        for p in np.ndindex(*value.shape):
            _add(code, target, list(p), known.items[p])
        return
    source = body.operand(value, value.shape)
    with nest(code, value.shape, [source, target]) as position:
        _add(code, target, position, fetch(code, source, position))


def _add(code: Code, target: Place, position, x: Ref) -> None:
    if x.value is not None and x.value == 0:
        return
    target.write(code, position, code.add(target.read(code, position), total(code, x)))


def total(code: Code, x: Ref) -> Ref:
    """The sum over lanes, in float64."""
    wide = x if x.dtype == "float64" else code.convert("fpext", x, "float64")
    if wide.lanes == 1:
        return wide
    name = f"@llvm.vector.reduce.fadd.v{wide.lanes}f64"
    code.module.declare(f"declare double {name}(double, {wide.type})")
    scalar = code.raw(f"call reassoc double {name}(double -0.0, {wide.type} {wide.text})")
    return Ref(code.raw(f"insertelement <1 x double> poison, double {scalar}, i64 0"), "float64", 1)


def add_rows(code: Code, place: Place, stride: str, count: str, target: Place) -> None:
    """Adds every element's sum over lanes and steps, some elements side by side."""
    size = math.prod(place.shape)
    flat = Place(place.base, place.offset, (size,), (1,), place.dtype, place.lanes)
    into = Place(target.base, target.offset, (size,), (1,), target.dtype, 1)

    def some(first: str, number: int) -> None:
        start = flat.address(code, [first])
        zeros = tuple(code.constant(0.0, place.dtype, place.lanes) for _ in range(number))
        with code.loop(count, zeros) as loop:
            row = code.pointer(start, code.index(f"mul nsw i64 {loop.i}, {stride}"))
            loop.results = [
                code.op(
                    "fadd",
                    total,
                    code.load(code.pointer(row, k * flat.unit), place.dtype, place.lanes),
                )
                for k, total in enumerate(loop.carried)
            ]
        for k, found in enumerate(loop.results):
            _add(code, into, [code.index(f"add nsw i64 {first}, {k}")], found)

    _ranges(code, size, 4, some)


def product_function(module, sizes: tuple[int, int], dtype: str, along: bool) -> str:
    """The function that adds sum over s of a[s, i] b[s, j] to a float64 matrix.

    With `along` it also adds the sum of a[s, i] to a vector: one more column, of ones.
    """
    rows, columns = sizes
    name = f"product_{dtype}_{rows}_{columns}{'_along' if along else ''}"
    if name in module.instances:
        return name
    module.instances[name] = None
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

            _ranges(code, wide + last, tile[1], block, apart=last)

        _ranges(code, rows, tile[0], tall)

    _ranges(code, columns, PANEL, panel, apart=along)
    code.do("ret void")
    header = (
        f"define internal void @{name}(ptr noalias %a, i64 %sa, ptr noalias %b, i64 %sb, "
        "i64 %count, ptr noalias %sum, ptr noalias %along) noinline nounwind"
    )
    module.define(header, code)
    return name


def _ranges(code: Code, size: int, tile: int, body, apart: bool = False) -> None:
    """Calls `body` for every tile, the last one `apart` from the loop where it is special."""
    whole, rest = divmod(size, tile)
    if apart and not rest and whole:
        whole, rest = whole - 1, tile
    if whole == 1:
        body("0", tile)
    elif whole:
        with code.loop(whole) as loop:
            body(code.index(f"mul nsw i64 {loop.i}, {tile}"), tile)
    if rest:
        body(str(size - rest), rest)


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
            own = [code.op("fadd", one, total) for one, total in zip(x, sums[len(pairs) :])]
            sums = products + own
        loop.results = sums
    totals = across(code, loop.results, width)
    row = code.index(f"mul nsw i64 {i}, {8 * columns}")
    target = code.pointer(code.pointer("%sum", row), code.index(f"shl i64 {j}, 3"))
    for r in range(height if breadth else 0):
        x = _pick(code, totals, [r * breadth + c for c in range(breadth)], width)
        _add_row(code, code.pointer(target, 8 * r * columns), x, range(breadth))
    if ones:
        x = _pick(code, totals, [height * breadth + r for r in range(height)], width)
        _add_row(code, code.pointer("%along", code.index(f"shl i64 {i}, 3")), x, range(height))


def across(code: Code, vectors: list[Ref], width: int) -> list[Ref]:
    """Lane k of result n is the sum over the lanes of vector n * width + k."""
    vectors = list(vectors)
    zero = code.constant(0.0, vectors[0].dtype, width)
    while len(vectors) % width:
        vectors.append(zero)
    results = []
    for start in range(0, len(vectors), width):
        group = vectors[start : start + width]
        distance = width // 2
        while distance:
            half = len(group) // 2
            group = [_halve(code, a, b, distance) for a, b in zip(group[:half], group[half:])]
            distance //= 2
        results.append(group[0])
    return results


def _halve(code: Code, a: Ref, b: Ref, distance: int) -> Ref:
    """Lanes without the bit `distance` add up a's pairs, lanes with it b's."""
    keep = [m if not m & distance else a.lanes + m for m in range(a.lanes)]
    cross = [m ^ distance if not m & distance else a.lanes + (m ^ distance) for m in range(a.lanes)]
    return code.op("fadd", _shuffle(code, a, b, keep), _shuffle(code, a, b, cross))


def _shuffle(code: Code, a: Ref, b: Ref, mask: list[int]) -> Ref:
    numbers = ", ".join(f"i32 {m}" for m in mask)
    text = f"shufflevector {a.type} {a.text}, {b.type} {b.text}, <{len(mask)} x i32> <{numbers}>"
    return Ref(code.raw(text), a.dtype, len(mask))


def _pick(code: Code, totals: list[Ref], picks: list[int], width: int) -> Ref:
    """Some of the sums as one short vector."""
    parts = sorted({p // width for p in picks})
    first = totals[parts[0]]
    second = totals[parts[-1]]
    mask = [p % width if p // width == parts[0] else width + p % width for p in picks]
    return _shuffle(code, first, second, mask)
