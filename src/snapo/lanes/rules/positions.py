"""Positions known only while running: their bounds, and the elements that lie there.

A position known while compiling costs nothing. A position that differs between paths becomes
selections or rearrangements (`lookups`) of up to 16 candidates, otherwise one masked gather.
"""

import numpy as np

from .. import Unsupported
from ..emit.code import Code
from ..emit.module import Ref
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues
from ..program.program import BIG, Op, ProgramValue
from . import elementwise
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
    """table[at]; of `at` only the low bits count."""
    if (code.module.register, np.dtype(table.dtype).itemsize) not in PERMUTES:
        return _permute_halves(code, table, at)
    name, kind = PERMUTES[code.module.register, np.dtype(table.dtype).itemsize]
    at = convert(code, at, kind)
    code.module.declare(f"declare {table.type} @{name}({table.type}, {at.type})")
    call = f"call {table.type} @{name}({table.type} {table.text}, {at.type} {at.text})"
    return Ref(code.raw(call), table.dtype, table.lanes)


def _permute_halves(code: Code, table: Ref, at: Ref) -> Ref:
    """Four numbers of eight bytes as eight of four, 2 i and 2 i + 1: no instruction permutes the
    four."""
    twice = code.op("shl", convert(code, at, "int64"), code.constant(1, "int64"))
    high = code.op("shl", twice, code.constant(32, "int64"))
    both = code.add(code.op("or", twice, high), code.constant(1 << 32, "int64"))
    lanes = 2 * table.lanes
    halves = code.recast(table, "float32", lanes)
    result = _permute(code, halves, code.recast(both, "int32", lanes))
    return code.recast(result, table.dtype, table.lanes)


SELECTED = 16  # most candidates for which selections beat a gather
LARGEST = 1024  # most elements read or written one by one

Start = Ref | int


def clamped(values: EmittedValues, start: ProgramValue, last: int) -> Start:
    """A start index within [0, last]: a number if it is known."""
    if start.constant is not None:
        return int(np.clip(int(start.constant), 0, last))
    return _clamp(values.code, values.small(start)[()], last)


def _clamp(code: Code, x: Ref, last: int) -> Start:
    if last == 0:
        return 0
    low, high = code.constant(0, x.dtype), code.constant(last, x.dtype)
    return elementwise.RULES["clamp"](code, low, x, high)


def limit(op: Op, moved: ProgramValue) -> None:
    """**Raises:** `Unsupported` for more elements than can be written out."""
    if moved.size > LARGEST:
        raise Unsupported(f"{op.name}: {moved.size} elements (at most {LARGEST}), at {op.where}")


def window_start(
    values: EmittedValues,
    x: ProgramValue,
    indices: ProgramValue,
    batch,
    index_map,
    sizes,
    check: bool,
):
    """The start of one window, clamped, and whether it was inside (None if it always is)."""
    code = values.code
    first: list[Start] = [0] * len(x.shape)
    valid: Ref | bool | None = None
    for k, d in enumerate(index_map):
        last = x.shape[d] - sizes[d]
        if indices.constant is not None:
            value = int(indices.constant[(*batch, k)])
            first[d] = int(np.clip(value, 0, last))
            inside: Ref | bool = 0 <= value <= last
        else:
            ref = values.small(indices)[(*batch, k)]
            first[d] = _clamp(code, ref, last)
            inside = True
            if check:
                low = compare(code, "ge", ref, code.constant(0, ref.dtype))
                high = compare(code, "le", ref, code.constant(last, ref.dtype))
                inside = code.op("and", low, high)
        if check and inside is not True:
            valid = _both(code, valid, inside)
    return first, valid


def _both(code: Code, a, b):
    if isinstance(a, Ref) and isinstance(b, Ref):
        return code.op("and", a, b)
    if a is None:
        return b
    if a is False or b is False:
        return False
    return a if isinstance(a, Ref) else b


def plus(code: Code, start: Start, by: int) -> Start:
    """A position `by` elements further on."""
    if isinstance(start, int):
        return start + by
    return code.add(start, code.constant(by, start.dtype)) if by else start


def read(values: EmittedValues, x: ProgramValue, position: list[Start]) -> Ref:
    """One element of an array, at numbers or at registers."""
    code, available = values.code, values.get(x)
    moving = [d for d, p in enumerate(position) if isinstance(p, Ref)]
    if not moving:
        at = [p for p in position if isinstance(p, int)]
        return (
            available.items[tuple(at)]
            if isinstance(available, Small)
            else available.read(code, list(at))
        )
    flat, count = flat_index(code, x.shape, position, moving)
    if (
        count <= SELECTED
        or x.dtype == np.bool_
        or (isinstance(available, Small) and count <= 2 * SELECTED)
    ):
        candidates = [_element(values, x, position, moving, i) for i in range(count)]
        return lookup(code, flat, candidates) if count > 1 else candidates[0]
    return load(code, values.in_memory(x), position)


def flat_index(code: Code, shape, position, moving) -> tuple[Ref, int]:
    """The moving part of a position as one number, and how many values it can take."""
    flat, count = None, 1
    for d in reversed(moving):
        part = (
            position[d]
            if count == 1
            else code.mul(position[d], code.constant(count, position[d].dtype))
        )
        flat = part if flat is None else code.add(*_same_type(code, flat, part))
        count *= shape[d]
    assert flat is not None
    return flat, count


def _same_type(code: Code, a: Ref, b: Ref):
    wide = max(a.dtype, b.dtype, key=lambda t: np.dtype(t).itemsize)
    return convert(code, a, wide), convert(code, b, wide)


def _element(values: EmittedValues, x: ProgramValue, position, moving, number: int) -> Ref:
    at = list(position)
    for d in reversed(moving):
        at[d] = number % x.shape[d]
        number //= x.shape[d]
    return values.small(x)[tuple(at)] if x.size <= 4 * BIG else read(values, x, at)


def load(code: Code, location: ArrayPlace, position) -> Ref:
    """One element from memory, at a position of which some part is in registers."""
    pointers, lanes, uniform = addresses(code, location, position)
    if uniform:
        return code.load(pointers, location.dtype, location.lanes, location.invariant)
    return code.gather_at(pointers, lanes, location.dtype)


def addresses(code: Code, location: ArrayPlace, position):
    """Addresses of one element in every lane; one address where all lanes agree."""
    fixed = [p if isinstance(p, int) else 0 for p in position]
    base = location.address(code, fixed)
    refs = [(p, s) for p, s in zip(position, location.strides) if isinstance(p, Ref) and s]
    total = None
    for p, stride in refs:
        wide = convert(code, p, "int64")
        part = code.mul(wide, code.constant(stride * location.unit, "int64"))
        total = part if total is None else code.add(total, part)
    assert total is not None
    if total.lanes == 1:
        scalar = code.raw(f"extractelement {total.type} {total.text}, i64 0", "i")
        return code.pointer(base, scalar), 1, True
    if location.lanes > 1:
        steps = ", ".join(f"i64 {i * location.dtype.itemsize}" for i in range(location.lanes))
        total = code.add(total, Ref(f"<{steps}>", "int64", location.lanes))
    return code.raw(f"getelementptr i8, ptr {base}, {total.type} {total.text}"), total.lanes, False
