"""Neighbours in a table that all paths share, read by every path from a position of its own.

Processors gather number by number. Several neighbours are faster read together, path by path, and
then transposed: one vector of lanes for each.
"""

import math
from collections.abc import Sequence

import numpy as np

from ..emit.code import Code
from ..emit.module import Module, Ref
from ..emit.storage import ArrayPlace
from ..emit.values import EmittedValues
from ..program.program import ProgramValue
from .positions import SELECTED, Start, addresses

NEIGHBOURS = 4  # of fewer, each is gathered
BLOCK = 16  # bytes of neighbours that are loaded at once: within these, numbers change places fast


def together(
    values: EmittedValues, x: ProgramValue, out: ProgramValue, moving: Sequence[int]
) -> bool:
    """Whether `copy_rows` reads the rows of `out` in a table `x` that all paths share, with too
    many places along the axes `moving` to select from."""
    place = values.get(x)
    if not isinstance(place, ArrayPlace) or place.lanes > 1 or place.strides[-1:] != (1,):
        return False
    candidates = math.prod(x.shape[d] for d in moving)
    wide = out.shape[-1:] >= (NEIGHBOURS,) and x.dtype != np.bool_
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
        place = code.pointer("%out", code.index(f"mul nsw i64 {first}, {unit * lanes}"))
        for k, column in enumerate(columns):
            code.store(column, code.pointer(place, k * unit * lanes), lanes)
    code.do("ret void")
    code.define(
        f"define internal void @{name}(<{lanes} x ptr> %rows, ptr noalias %out) noinline nounwind"
    )
    return name


def transposed(code: Code, rows: list[Ref]) -> list[Ref]:
    """Vectors of blocks, each block with as many numbers as there are vectors, a power of two:
    every block of them transposed.

    Each round interleaves every vector with the one half of them further on. Of the bits of a
    number's place, row before column, this moves the first to the end.
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
