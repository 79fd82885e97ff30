"""Reading at positions known only while running: gather and dynamic slices.

Processors gather number by number. For neighbours in a table that all paths share it is faster to
read path by path and then transpose, to one vector of lanes for each neighbour.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..emit.code import Code
from ..emit.module import Module, Ref
from ..emit.storage import ArrayPlace
from ..emit.values import EmittedValues
from ..program.program import Op, ProgramValue
from .positions import SELECTED, Start, addresses, clamped, limit, plus, read, window_start

NEIGHBOURS = 4  # of fewer, each is gathered
BLOCK = 16  # bytes of neighbours that are loaded at once: within these, numbers change places fast


def together(
    values: EmittedValues, x: ProgramValue, out: ProgramValue, moving: Sequence[int]
) -> bool:
    """Whether `copy_rows` reads the rows of `out` in a table `x` that all paths share, with too
    many positions along the axes `moving` to select from."""
    table = values.get(x)
    if not isinstance(table, ArrayPlace) or table.lanes > 1 or table.strides[-1:] != (1,):
        return False
    candidates = math.prod(x.shape[d] for d in moving)
    wide = out.shape[-1:] >= (NEIGHBOURS,) and NEIGHBOURS * table.unit >= BLOCK
    return out.path and wide and candidates > SELECTED


def copy_rows(code: Code, table: ArrayPlace, position: list[Start], count: int, out: str) -> None:
    """Copies `count` neighbours of every path to `out`, [count, lanes]."""
    pointers, lanes, uniform = addresses(code, table, position)
    if uniform:
        for k in range(count):
            number = code.load(code.pointer(pointers, k * table.unit), table.dtype, 1)
            code.store(number, code.pointer(out, k * table.unit * code.lanes), code.lanes)
        return
    name = _function(code.module, table.dtype, count)
    code.do(f"call void @{name}(<{lanes} x ptr> {pointers}, ptr {out})")


def _function(module: Module, dtype: np.dtype, count: int) -> str:
    """The function that does it. It is not inlined: a kernel has many of these reads."""
    name = f"rows_{dtype.name}_{count}"
    if not module.first(name):
        return name
    code, unit, lanes = Code(module.lanes, module), dtype.itemsize, module.lanes
    width = min(BLOCK // unit, lanes)
    rows = [
        code.raw(f"extractelement <{lanes} x ptr> %rows, i64 {lane}", "p") for lane in range(lanes)
    ]
    with code.loop(-(-count // width)) as loop:
        first = code.index(f"mul nsw i64 {loop.i}, {width}")
        if count % width:  # the last block overlaps the one before
            inside = code.index(f"icmp slt i64 {first}, {count - width}")
            first = code.index(f"select i1 {inside}, i64 {first}, i64 {count - width}")
        distance = code.index(f"mul nsw i64 {first}, {unit}")
        blocks = [code.load(code.pointer(row, distance), dtype, width, align=unit) for row in rows]
        columns = transposed(code, [code.join(blocks[k::width]) for k in range(width)])
        target = code.pointer("%out", code.index(f"mul nsw i64 {first}, {unit * lanes}"))
        for k, column in enumerate(columns):
            code.store(column, code.pointer(target, k * unit * lanes), lanes)
    code.do("ret void")
    code.define(
        f"define internal void @{name}(<{lanes} x ptr> %rows, ptr noalias %out) noinline nounwind"
    )
    return name


def transposed(code: Code, rows: list[Ref]) -> list[Ref]:
    """Blocks, transposed. A block has one row from each vector, and as many columns as there are
    vectors, a power of two.

    Each round interleaves vector i of n with vector i + n/2. This moves the
    first bit of the position of a number (row, then column) to the end.
    """
    width, lanes = len(rows), rows[0].lanes
    masks = [
        ", ".join(
            f"i32 {block + k}, i32 {block + k + lanes}"
            for block in range(0, lanes, width)
            for k in range(first, first + width // 2)
        )
        for first in (0, width // 2)
    ]
    for _ in range(width.bit_length() - 1):
        pairs = zip(rows[: width // 2], rows[width // 2 :])
        rows = [code.shuffle(a, b, mask) for a, b in pairs for mask in masks]
    return rows


def _dynamic_slice(values: EmittedValues, op: Op) -> None:
    x, *starts = op.inputs
    out = op.outputs[0]
    limit(op, out)
    window = op.params["slice_sizes"]
    first = [clamped(values, s, n - w) for s, n, w in zip(starts, x.shape, window)]

    def moves(shape: tuple[int, ...]) -> Iterator:
        return ((position, first, position, None) for position in np.ndindex(*shape))

    moving = [d for d, start in enumerate(first) if isinstance(start, Ref)]
    if together(values, x, out, moving):
        _copy(values, x, out, moves)
    else:
        _read_all(values, op, x, moves(out.shape))


def _gather(values: EmittedValues, op: Op) -> None:
    x, indices = op.inputs
    out = op.outputs[0]
    limit(op, out)
    p = op.params
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    mode = str(p["mode"])
    fill = p.get("fill_value")
    window_dims = [
        d for d in range(len(x.shape))
        if d not in numbers.collapsed_slice_dims and d not in numbers.operand_batching_dims
    ]  # fmt: skip
    batch_dims = [d for d in range(len(out.shape)) if d not in numbers.offset_dims]

    def moves(shape: tuple[int, ...]) -> Iterator:
        for position in np.ndindex(*shape):
            batch = tuple(position[d] for d in batch_dims)
            window = [0] * len(x.shape)
            for d, o in zip(window_dims, numbers.offset_dims):
                window[d] = position[o]
            first, valid = window_start(
                values, x, indices, batch, numbers.start_index_map, sizes, "FILL" in mode
            )
            for d, b in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims):
                first[d] = batch[b]
            yield position, first, window, valid

    # Neighbours of the result are neighbours in the array.
    inner = window_dims[-1:] == [len(x.shape) - 1] and batch_dims[-1:] != [len(out.shape) - 1]
    moving = [d for d in numbers.start_index_map if x.shape[d] > sizes[d]]
    if inner and "FILL" not in mode and together(values, x, out, moving):
        _copy(values, x, out, moves)
    else:
        _read_all(values, op, x, moves(out.shape), fill)


def _copy(values: EmittedValues, x: ProgramValue, out: ProgramValue, moves) -> None:
    """Copies the result row by row; `moves`: the reads for all positions of a shape."""
    code, table, target = values.code, values.in_memory(x), values.target(out)
    for position, first, window, _ in moves((*out.shape[:-1], 1)):
        start = [plus(code, s, w) for s, w in zip(first, window)]
        copy_rows(code, table, start, out.shape[-1], target.address(code, position))
    values.bind(out, target)


def _read_all(values: EmittedValues, op: Op, x: ProgramValue, moves, fill=None) -> None:
    out, code = op.outputs[0], values.code
    refs = np.empty(out.shape, object)
    for position, first, window, valid in moves:
        if valid is False:
            refs[position] = _filler(code, out, fill)
            continue
        ref = read(values, x, [plus(code, s, w) for s, w in zip(first, window)])
        refs[position] = ref if valid is None else code.select(valid, ref, _filler(code, out, fill))
    values.set(out, refs)


def _filler(code: Code, out: ProgramValue, fill) -> Ref:
    """XLA's number for an index out of range: NaN, or the extreme of an integer type."""
    if fill is None:
        kind = out.dtype.kind
        fill = np.nan if kind == "f" else True if kind == "b" else None
        if fill is None:
            info = np.iinfo(out.dtype)
            fill = info.max if kind == "u" else info.min
    return code.constant(fill, out.dtype)


RULES = {"dynamic_slice": _dynamic_slice, "gather": _gather}
