"""Reading and writing at positions known only while running: gather, scatter, dynamic slices.

A position known while compiling costs nothing. One that differs between paths becomes selections
or rearrangements (`lookups`) of up to 16 candidates, else one masked gather over the lanes.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from . import elementwise
from .code import Code, Ref
from .lookups import lookup
from .passes import BIG
from .program import Op, Unsupported, Value
from .storage import Place, Small, row_major

SELECTED = 16  # most candidates for which selections beat a gather
LARGEST = 1024  # most elements read or written one by one

Start = Ref | int


def _dynamic_slice(body, op: Op) -> None:
    x, *starts = op.inputs
    out = op.outputs[0]
    _limit(op, out)
    window = op.params["slice_sizes"]
    first = [_clamped(body, s, n - w) for s, n, w in zip(starts, x.shape, window)]
    _read_all(body, op, x, ((p, first, p, None) for p in np.ndindex(*out.shape)))


def _dynamic_update_slice(body, op: Op) -> None:
    x, update, *starts = op.inputs
    _limit(op, update)
    first = [_clamped(body, s, n - w) for s, n, w in zip(starts, x.shape, update.shape)]
    _write_all(body, op, x, update, ((p, first, p, None) for p in np.ndindex(*update.shape)), None)


def _clamped(body, start: Value, last: int) -> Start:
    """A start index within [0, last]: a number where it is known."""
    if start.constant is not None:
        return int(np.clip(int(start.constant), 0, last))
    return _clamp(body.code, body.small(start)[()], last)


def _clamp(code: Code, x: Ref, last: int) -> Start:
    if last == 0:
        return 0
    low, high = code.constant(0, x.dtype), code.constant(last, x.dtype)
    return elementwise.RULES["clamp"](code, low, x, high)


def _limit(op: Op, moved: Value) -> None:
    if moved.size > LARGEST:
        raise Unsupported(f"{op.name}: of {moved.size} elements (at most {LARGEST}), at {op.where}")


def _gather(body, op: Op) -> None:
    x, indices = op.inputs
    out = op.outputs[0]
    _limit(op, out)
    p = op.params
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    mode = str(p["mode"])
    fill = p.get("fill_value")
    window_dims = [
        d for d in range(len(x.shape))
        if d not in numbers.collapsed_slice_dims and d not in numbers.operand_batching_dims
    ]  # fmt: skip
    batch_dims = [d for d in range(len(out.shape)) if d not in numbers.offset_dims]

    def moves() -> Iterator:
        for position in np.ndindex(*out.shape):
            batch = tuple(position[d] for d in batch_dims)
            window = [0] * len(x.shape)
            for d, o in zip(window_dims, numbers.offset_dims):
                window[d] = position[o]
            first, valid = _starts(
                body, x, indices, batch, numbers.start_index_map, sizes, "FILL" in mode
            )
            for d, b in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims):
                first[d] = batch[b]
            yield position, first, window, valid

    _read_all(body, op, x, moves(), fill)


def _starts(body, x: Value, indices: Value, batch, index_map, sizes, check: bool):
    """The start of one window, clamped, and whether it was inside (None where it always is)."""
    code = body.code
    first: list[Start] = [0] * len(x.shape)
    valid: Ref | bool | None = None
    for k, d in enumerate(index_map):
        last = x.shape[d] - sizes[d]
        if indices.constant is not None:
            value = int(indices.constant[(*batch, k)])
            first[d] = int(np.clip(value, 0, last))
            inside: Ref | bool = 0 <= value <= last
        else:
            ref = body.small(indices)[(*batch, k)]
            first[d] = _clamp(code, ref, last)
            inside = True
            if check:
                low = elementwise.compare(code, "ge", ref, code.constant(0, ref.dtype))
                high = elementwise.compare(code, "le", ref, code.constant(last, ref.dtype))
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


def _read_all(body, op: Op, x: Value, moves, fill=None) -> None:
    out, code = op.outputs[0], body.code
    refs = np.empty(out.shape, object)
    for position, first, window, valid in moves:
        if valid is False:
            refs[position] = _filler(code, out, fill)
            continue
        ref = read(body, x, [_plus(code, s, w) for s, w in zip(first, window)])
        refs[position] = ref if valid is None else code.select(valid, ref, _filler(code, out, fill))
    body.set(out, refs)


def _filler(code: Code, out: Value, fill) -> Ref:
    """What XLA puts where an index is out of range: NaN, or the extreme of an integer type."""
    if fill is None:
        kind = out.dtype.kind
        fill = np.nan if kind == "f" else True if kind == "b" else None
        if fill is None:
            info = np.iinfo(out.dtype)
            fill = info.max if kind == "u" else info.min
    return code.constant(fill, out.dtype)


def _plus(code: Code, start: Start, by: int) -> Start:
    if isinstance(start, int):
        return start + by
    return code.add(start, code.constant(by, start.dtype)) if by else start


def read(body, x: Value, position: list[Start]) -> Ref:
    """One element of an array, at numbers or at registers."""
    code, known = body.code, body.get(x)
    moving = [d for d, p in enumerate(position) if isinstance(p, Ref)]
    if not moving:
        at = [p for p in position if isinstance(p, int)]
        return known.items[tuple(at)] if isinstance(known, Small) else known.read(code, list(at))
    flat, count = _flat(code, x.shape, position, moving)
    if (
        count <= SELECTED
        or x.dtype == np.bool_
        or (isinstance(known, Small) and count <= 2 * SELECTED)
    ):
        candidates = [_element(body, x, position, moving, i) for i in range(count)]
        return lookup(code, flat, candidates) if count > 1 else candidates[0]
    return _load(code, body.place(x), position)


def _flat(code: Code, shape, position, moving) -> tuple[Ref, int]:
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
    return elementwise.convert(code, a, wide), elementwise.convert(code, b, wide)


def _element(body, x: Value, position, moving, number: int) -> Ref:
    at = list(position)
    for d in reversed(moving):
        at[d] = number % x.shape[d]
        number //= x.shape[d]
    return body.small(x)[tuple(at)] if x.size <= 4 * BIG else read(body, x, at)


def _load(code: Code, place: Place, position) -> Ref:
    pointers, lanes, uniform = _pointers(code, place, position)
    if uniform:
        return code.load(pointers, place.dtype, place.lanes, place.invariant)
    return code.gather_at(pointers, lanes, place.dtype)


def _pointers(code: Code, place: Place, position):
    """Addresses of one element in every lane; one address where all lanes agree."""
    fixed = [p if isinstance(p, int) else 0 for p in position]
    base = place.address(code, fixed)
    refs = [(p, s) for p, s in zip(position, place.strides) if isinstance(p, Ref) and s]
    total = None
    for p, stride in refs:
        wide = elementwise.convert(code, p, "int64")
        part = code.mul(wide, code.constant(stride * place.unit, "int64"))
        total = part if total is None else code.add(total, part)
    assert total is not None
    if total.lanes == 1:
        scalar = code.raw(f"extractelement {total.type} {total.text}, i64 0", "i")
        return code.pointer(base, scalar), 1, True
    if place.lanes > 1:
        steps = ", ".join(f"i64 {i * place.dtype.itemsize}" for i in range(place.lanes))
        total = code.add(total, Ref(f"<{steps}>", "int64", place.lanes))
    return code.raw(f"getelementptr i8, ptr {base}, {total.type} {total.text}"), total.lanes, False


SCATTERS = {
    "scatter": None,
    "scatter-add": "add",
    "scatter_add": "add",
    "scatter-mul": "mul",
    "scatter_mul": "mul",
    "scatter-sub": "sub",
    "scatter-min": "min",
    "scatter-max": "max",
}


def _scatter(body, op: Op) -> None:
    x, indices, update = op.inputs
    _limit(op, update)
    numbers, mode = op.params["dimension_numbers"], str(op.params["mode"])
    batching = numbers.operand_batching_dims
    inner = [
        d
        for d in range(len(x.shape))
        if d not in numbers.inserted_window_dims and d not in batching
    ]
    outer = [d for d in range(len(update.shape)) if d not in numbers.update_window_dims]
    sizes = [1] * len(x.shape)
    for d, u in zip(inner, numbers.update_window_dims):
        sizes[d] = update.shape[u]

    def moves() -> Iterator:
        for position in np.ndindex(*update.shape):
            batch = tuple(position[d] for d in outer)
            window = [0] * len(x.shape)
            for d, u in zip(inner, numbers.update_window_dims):
                window[d] = position[u]
            map_ = numbers.scatter_dims_to_operand_dims
            first, valid = _starts(body, x, indices, batch, map_, sizes, "CLIP" not in mode)
            for d, b in zip(batching, numbers.scatter_indices_batching_dims):
                first[d] = batch[b]
            yield position, first, window, valid

    _write_all(body, op, x, update, moves(), SCATTERS[op.name])


def _write_all(body, op: Op, x: Value, update: Value, moves, combine: str | None) -> None:
    """A copy of `x` with elements replaced, or combined with what is written."""
    out, code = op.outputs[0], body.code
    known = body.get(x)
    small = out.size <= BIG or (
        isinstance(known, Small) and known.uniform is None and out.size <= 4 * BIG
    )
    items = body.small(x).copy() if small else None
    target = None
    if items is None:
        target = body.target(out)
        body.copy(x, target)
        body.where[out] = target
    updates = body.small(update)
    for position, first, window, valid in moves:
        if valid is False:
            continue
        at = [_plus(code, s, w) for s, w in zip(first, window)]
        new = updates[position]
        if items is not None:
            _write_small(body, items, at, new, valid, combine)
        else:
            assert target is not None
            _write_memory(code, target, at, new, valid, combine, op)
    if items is not None:
        body.set(out, items)


def _merge(code: Code, old: Ref, new: Ref, hit: Ref | None, combine: str | None) -> Ref:
    if combine is not None:
        new = elementwise.RULES["add_any" if combine == "add" else combine](code, old, new)
    return new if hit is None else code.select(hit, new, old)


def _write_small(body, items, at, new: Ref, valid, combine) -> None:
    code = body.code
    moving = [d for d, p in enumerate(at) if isinstance(p, Ref)]
    if not moving:
        items[tuple(at)] = _merge(code, items[tuple(at)], new, valid, combine)
        return
    flat, count = _flat(code, items.shape, at, moving)
    for number in range(count):
        place, rest = list(at), number
        for d in reversed(moving):
            place[d] = rest % items.shape[d]
            rest //= items.shape[d]
        hit = elementwise.compare(code, "eq", flat, code.constant(number, flat.dtype))
        hit = hit if valid is None else code.op("and", hit, valid)
        items[tuple(place)] = _merge(code, items[tuple(place)], new, hit, combine)


def _write_memory(code: Code, target: Place, at, new: Ref, valid, combine, op: Op) -> None:
    if all(isinstance(p, int) for p in at):
        old = target.read(code, at)
        target.write(code, at, _merge(code, old, new, valid, combine))
        return
    if target.dtype == np.bool_:
        raise Unsupported(f"{op.name}: into booleans at positions that move, at {op.where}")
    old = _load(code, target, at)
    merged = code.splat(_merge(code, old, new, valid, combine), target.lanes)
    pointers, lanes, uniform = _pointers(code, target, at)
    if uniform:
        code.store(merged, pointers, target.lanes)
        return
    suffix = f"v{lanes}{'f' if target.dtype.kind == 'f' else 'i'}{target.dtype.itemsize * 8}"
    name = f"@llvm.masked.scatter.{suffix}.v{lanes}p0"
    code.module.declare(f"declare void {name}({merged.type}, <{lanes} x ptr>, i32, <{lanes} x i1>)")
    code.do(
        f"call void {name}({merged.type} {merged.text}, <{lanes} x ptr> {pointers}, "
        f"i32 {target.dtype.itemsize}, <{lanes} x i1> splat (i1 true))"
    )


RULES = {
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    **dict.fromkeys(SCATTERS, _scatter),
}
__all__ = ["RULES", "read", "replace", "row_major"]
