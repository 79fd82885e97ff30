"""Dot products in register tiles; `gradients` has the product over steps."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..emit.code import Code
from ..emit.module import Ref
from ..emit.storage import ArrayPlace
from ..emit.values import EmittedValues
from ..program.program import Op, ProgramValue

WRITTEN_OUT = 64  # multiply-adds of a dot product that is not made a loop
LONG = 64  # elements of a row that is examined for zeros at its end
ACCUMULATORS, FEW = 16, 12  # vector registers that hold a tile's sums; if there are 16 only


# Takes each sum: its position in the flattened result, and its register.
Finish = Callable[[int | str, Ref], None]


def tiles(op: Op) -> bool:
    """Whether a dot product is done in tiles; small ones are written out."""
    return _work(op) > WRITTEN_OUT


def _work(op: Op) -> int:
    (contract, _), _ = op.params["dimension_numbers"]
    return op.outputs[0].size * _count(op.inputs[0], contract)


def dot(values: EmittedValues, op: Op, finish: Finish | None = None) -> None:
    """`dot_general` with any batch, free and contracted axes.

    In tiles, `finish` receives each sum from its register; without `finish` sums are stored.
    """
    (contract_a, contract_b), (batch_a, batch_b) = op.params["dimension_numbers"]
    a, b = op.inputs
    free_a, free_b = _free(op)
    sizes = _sizes(op)
    if not tiles(op):
        _written_out(
            values, op, (batch_a, free_a, contract_a), (batch_b, free_b, contract_b), sizes
        )
        return
    left = _axes(values.in_memory(a), batch_a, free_a, contract_a)
    right = _axes(values.in_memory(b), batch_b, free_b, contract_b)
    finish = finish or _stored(values, op.outputs[0])
    finite = any(v in values.finite for v in (a, b))
    tiled(values.code, left, right, op.outputs[0], sizes, finish, finite)


def rounds(code: Code, op: Op) -> int:
    """The numbers of rounds of the loops of a dot product; none if it is not done in tiles."""
    if op.name != "dot_general" or not tiles(op):
        return 0
    (a, b), (batch, rows, columns, depth) = op.inputs, _sizes(op)
    if _swapped(a.path, b.path, rows, columns):
        rows, columns = columns, rows
    high = even_tiles(rows, _tallest(code, op.outputs[0]))
    return batch * sum(count for _, count, _ in high) * columns * (depth // _unrolled(depth))


def _free(op: Op) -> list[list[int]]:
    """The axes of both inputs that are neither contracted nor common."""
    return [
        [i for i in range(len(v.shape)) if i not in (*contract, *batch)]
        for v, contract, batch in zip(op.inputs, *op.params["dimension_numbers"])
    ]


def _sizes(op: Op) -> tuple[int, int, int, int]:
    """The numbers of common, left, right and contracted elements."""
    (contract, _), (batch, _) = op.params["dimension_numbers"]
    (a, b), (free_a, free_b) = op.inputs, _free(op)
    return _count(a, batch), _count(a, free_a), _count(b, free_b), _count(a, contract)


def _stored(values: EmittedValues, out: ProgramValue) -> Finish:
    """Writes the sums to memory, as they come."""
    target = values.target(out)
    values.bind(out, target)
    flat = replace(target, shape=(out.size,), strides=(1,))
    return lambda position, total: flat.write(values.code, [position], total)


def _count(v: ProgramValue, axes) -> int:
    return math.prod([v.shape[i] for i in axes])


def _axes(position: ArrayPlace, *groups) -> list[Any]:
    """For every group of axes, (size, stride) pairs of this place."""
    return [
        position,
        *[[(position.shape[i], position.strides[i]) for i in group] for group in groups],
    ]


def _written_out(values: EmittedValues, op: Op, left, right, sizes) -> None:
    code = values.code
    a = values.small(op.inputs[0]).transpose([i for g in left for i in g])
    b = values.small(op.inputs[1]).transpose([i for g in right for i in g])
    batch, rows, columns, depth = sizes
    a, b = a.reshape(batch, rows, depth), b.reshape(batch, columns, depth)
    refs = np.empty((batch, rows, columns), object)
    for n, i, j in np.ndindex(batch, rows, columns):
        terms = list(zip(a[n, i], b[n, j]))
        total = code.mul(*terms[0]) if terms else code.constant(0, op.outputs[0].dtype)
        for x, y in terms[1:]:
            total = code.fma(*code.same(x, y, total))
        refs[n, i, j] = total
    values.set(op.outputs[0], refs.reshape(op.outputs[0].shape))


def tiled(
    code: Code, left, right, out: ProgramValue, sizes, finish: Finish, finite: bool = False
) -> None:
    """Sums over k of left[n, i, k] * right[n, j, k], in tiles of rows.

    Zeros at the end of long rows are left out if the factor of each path is `finite`.
    """
    batch, rows, columns, depth = sizes
    order = (rows * columns, columns, 1)
    if _swapped(left[0].lanes > 1, right[0].lanes > 1, rows, columns):
        left, right, rows, columns = right, left, columns, rows
        order = (columns * rows, 1, rows)
    lanes = max(left[0].lanes, right[0].lanes)
    short = finite and left[0].lanes < lanes and depth >= LONG and [s for _, s in left[3]] == [1]
    zero = code.constant(0, out.dtype, lanes)
    length = depth // _unrolled(depth)
    for first, count, height in even_tiles(rows, _tallest(code, out)):
        before = code.ahead.take(batch * count * columns * length) if code.ahead else 0
        with counted(code, batch) as n, counted(code, count) as i, counted(code, columns) as j:
            row = _plus(code, _times(code, i, height), first)
            start = _times(code, _flat(code, (n, i, j), (count * columns, columns, 1)), length)
            start = _plus(code, start, before)
            tile = (n, row, j), depth, [zero] * height, start
            totals = _tile(code, left, right, *tile, short)
            for r, total in enumerate(totals):
                finish(_flat(code, (n, _plus(code, row, r), j), order), total)


def _swapped(wide_left: bool, wide_right: bool, rows: int, columns: int) -> bool:
    """Whether tiles are of the right input's rows: those that all paths share, or several."""
    return (wide_left and not wide_right) or (rows == 1 and columns > 1)


def _tallest(code: Code, out: ProgramValue) -> int:
    """Rows of a tile whose sums fit in the registers."""
    registers = max(1, code.lanes * out.dtype.itemsize // code.module.register)
    return max(2, (FEW if code.module.few else ACCUMULATORS) // registers)


def even_tiles(rows: int, largest: int) -> list[tuple[int, int, int]]:
    """(first row, count, height) of tiles of two heights: a low last tile would leave the processor
    idle.

    A multiply-add takes four cycles, and two begin in each cycle.
    """
    tiles = -(-rows // largest)
    height, taller = divmod(rows, tiles)
    low = (taller * (height + 1), tiles - taller, height)
    return [(0, taller, height + 1), low] if taller else [low]


def _tile(
    code: Code, left, right, position, depth: int, totals: list[Ref], number: int | str, short: bool
) -> list[Ref]:
    """The sums of neighbouring rows, in one column; `number` is that of its first round.

    `short`: rounds at the end in which all of the rows are zero are left out.
    """
    place_a, batch_a, free_a, depth_a = left
    place_b, batch_b, free_b, depth_b = right
    n, first, j = position
    base_a = _at(code, place_a, [(n, batch_a)])
    rows = [_at(code, base_a, [((first, r), free_a)]) for r in range(len(totals))]
    base_b = _at(code, place_b, [(n, batch_b), (j, free_b)])
    unrolled = _unrolled(depth)
    rounds = depth // unrolled
    if short:
        rounds = code.without_last(rounds, lambda k: _zero(code, rows, k, unrolled, depth_a))
    with code.loop(rounds, tuple(totals)) as loop:
        totals = list(loop.carried)
        if code.ahead:
            code.ahead.fetch(loop.i, number)
        start = _times(code, loop.i, unrolled)
        for u in range(unrolled):
            b = _at(code, base_b, [((start, u), depth_b)]).read(code, [])
            for r, row in enumerate(rows):
                a = _at(code, row, [((start, u), depth_a)]).read(code, [])
                totals[r] = code.fma(*code.same(a, b, totals[r]))
        loop.results = totals
    return totals


def _zero(code: Code, rows: list[ArrayPlace], number: str, unrolled: int, axes) -> str:
    """Whether the numbers of one round are zero in all rows."""
    kind = f"uint{8 * rows[0].dtype.itemsize}"
    start, bits = _times(code, number, unrolled), None
    for row in rows:
        location = _at(code, row, [(start, axes)])
        pointer = code.pointer(location.base, location.offset)
        x = code.load(pointer, kind, unrolled, align=row.dtype.itemsize)
        bits = x if bits is None else code.op("or", bits, x)
    assert bits is not None
    size = code.op("shl", bits, code.constant(1, kind, unrolled))  # without the sign
    scalar = f"i{8 * rows[0].dtype.itemsize}"
    name = f"@llvm.vector.reduce.or.v{unrolled}{scalar}"
    code.module.declare(f"declare {scalar} {name}({size.type})")
    return code.index(
        f"icmp eq {scalar} {code.raw(f'call {scalar} {name}({size.type} {size.text})')}, 0"
    )


def _unrolled(depth: int) -> int:
    """Steps of a sum that are written out in one round."""
    return next(u for u in (depth if depth < 8 else 4, 4, 3, 2, 1) if depth % u == 0)


def _times(code: Code, i, factor: int):
    if isinstance(i, int):
        return i * factor
    return code.index(f"mul nsw i64 {i}, {factor}") if factor != 1 else i


def _flat(code: Code, position, order) -> int | str:
    """The place in the flattened result."""
    parts = [_times(code, p, o) for p, o in zip(position, order)]
    flat = sum(p for p in parts if isinstance(p, int))
    for part in (p for p in parts if isinstance(p, str)):
        flat = _plus(code, part, flat)
    return flat


class counted:
    """A loop, or no loop if there is one round."""

    def __init__(self, code: Code, count: int):
        self.loop = code.loop(count) if count != 1 else None

    def __enter__(self):
        return 0 if self.loop is None else self.loop.__enter__().i

    def __exit__(self, *error) -> None:
        if self.loop is not None and error[0] is None:
            self.loop.__exit__(None, None, None)


def _plus(code: Code, first, r):
    if isinstance(first, int) and isinstance(r, int):
        return first + r
    return code.index(f"add nsw i64 {first}, {r}") if r else first


def _at(code: Code, location: ArrayPlace, moves) -> ArrayPlace:
    """The place seen from given positions along groups of axes; the result has no axes."""
    pointer, fixed = location.base, location.offset
    dynamic = []
    for position, axes in moves:
        pair = position if isinstance(position, tuple) else (position, 0)
        if len(axes) == 1 or all(a[1] == _merged(axes)[i] for i, a in enumerate(axes)):
            stride = axes[-1][1] if axes else 0
            for part in pair:
                if isinstance(part, int):
                    fixed = fixed + part * stride * location.unit
                else:
                    dynamic.append((part, stride * location.unit))
            continue
        flat = _plus(code, pair[0], pair[1])
        for size, stride in reversed(axes):
            if isinstance(flat, int):
                fixed += flat % size * stride * location.unit
                flat //= size
            else:
                digit = code.index(f"urem i64 {flat}, {size}")
                dynamic.append((digit, stride * location.unit))
                flat = code.index(f"udiv i64 {flat}, {size}")
    for part, scale in dynamic:
        if scale:
            pointer = code.pointer(pointer, code.index(f"mul nsw i64 {part}, {scale}"))
    return ArrayPlace(pointer, fixed, (), (), location.dtype, location.lanes, location.invariant)


def _merged(axes) -> list[int]:
    """The strides that would make these axes one."""
    strides, step = [], axes[-1][1]
    for size, _ in reversed(axes):
        strides.append(step)
        step *= size
    return strides[::-1]
