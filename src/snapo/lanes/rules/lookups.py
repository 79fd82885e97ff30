"""One of some numbers that all paths share, chosen by an integer of each path's own.

A register of the processor is a table itself: one instruction rearranges its numbers by a vector
of positions. Longer tables are several registers, and one of their results is selected.
"""

import numpy as np

from ..emit.code import Code
from ..emit.ref import Ref
from .conversions import compare, convert
from .elementwise import select

FEWEST = 5  # fewer are selected: filling a register costs a few instructions too
# By bytes of a register and of a number: LLVM's name, and the positions' type.
PERMUTES = {
    (32, 4): ("llvm.x86.avx2.permps", "int32"),
    (64, 4): ("llvm.x86.avx512.permvar.sf.512", "int32"),
    (64, 8): ("llvm.x86.avx512.permvar.df.512", "int64"),
}


def lookup(code: Code, which: Ref, options: list[Ref]) -> Ref:
    """The option with the number `which`, from 0 to one less than there are."""
    size, register = np.dtype(options[0].dtype).itemsize, code.module.register
    floating = options[0].dtype in ("float32", "float64")
    usual = code.module.x86 and floating and register in (32, 64)
    if not usual or which.lanes == 1 or len(options) < FEWEST or any(o.lanes > 1 for o in options):
        return select(code, which, *options)
    width = register // size
    which = convert(code, which, "int32")
    tables = []
    for first in range(0, len(options), width):
        chunk = options[first : first + width]
        tables.append(code.join(chunk + chunk[-1:] * (width - len(chunk))))
    parts = []
    for k in range(which.lanes // width):
        at = code.part(which, k, width)
        results = [_permute(code, table, at) for table in tables]
        result = results[0]
        for i, other in enumerate(results[1:], 1):
            outside = compare(code, "ge", at, code.constant(i * width, "int32"))
            result = code.select(outside, other, result)
        parts.append(result)
    return code.join(parts)


def _permute(code: Code, table: Ref, at: Ref) -> Ref:
    """table[at], of which only the low bits count."""
    if (code.module.register, np.dtype(table.dtype).itemsize) not in PERMUTES:
        return _permute_halves(code, table, at)
    name, kind = PERMUTES[code.module.register, np.dtype(table.dtype).itemsize]
    at = convert(code, at, kind)
    code.module.declare(f"declare {table.type} @{name}({table.type}, {at.type})")
    call = f"call {table.type} @{name}({table.type} {table.text}, {at.type} {at.text})"
    return Ref(code.raw(call), table.dtype, table.lanes)


def _permute_halves(code: Code, table: Ref, at: Ref) -> Ref:
    """Four numbers of eight bytes, for want of an instruction as eight of four: 2 i and 2 i + 1."""
    twice = code.op("shl", convert(code, at, "int64"), code.constant(1, "int64"))
    high = code.op("shl", twice, code.constant(32, "int64"))
    both = code.add(code.op("or", twice, high), code.constant(1 << 32, "int64"))
    lanes = 2 * table.lanes
    halves = code.recast(table, "float32", lanes)
    result = _permute(code, halves, code.recast(both, "int32", lanes))
    return code.recast(result, table.dtype, table.lanes)
