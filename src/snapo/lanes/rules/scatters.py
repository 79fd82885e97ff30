"""Writing at positions known only while running: scatter and updates of dynamic slices."""

from collections.abc import Iterator

import numpy as np

from .. import Unsupported
from ..emit.code import Code
from ..emit.module import Ref
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues
from ..program.program import BIG, Op, ProgramValue
from . import elementwise
from .conversions import compare
from .positions import addresses, clamped, flat_index, limit, load, plus, window_start

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


def _dynamic_update_slice(values: EmittedValues, op: Op) -> None:
    x, update, *starts = op.inputs
    limit(op, update)
    first = [clamped(values, s, n - w) for s, n, w in zip(starts, x.shape, update.shape)]
    _write_all(
        values, op, x, update, ((p, first, p, None) for p in np.ndindex(*update.shape)), None
    )


def _scatter(values: EmittedValues, op: Op) -> None:
    x, indices, update = op.inputs
    limit(op, update)
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
            first, valid = window_start(values, x, indices, batch, map_, sizes, "CLIP" not in mode)
            for d, b in zip(batching, numbers.scatter_indices_batching_dims):
                first[d] = batch[b]
            yield position, first, window, valid

    _write_all(values, op, x, update, moves(), SCATTERS[op.name])


def _write_all(
    values: EmittedValues, op: Op, x: ProgramValue, update: ProgramValue, moves, combine: str | None
) -> None:
    """A copy of `x` with elements replaced by the update's, or combined with them."""
    out, code = op.outputs[0], values.code
    available = values.get(x)
    small = out.size <= BIG or (
        isinstance(available, Small) and available.uniform is None and out.size <= 4 * BIG
    )
    items = values.small(x).copy() if small else None
    target = None
    if items is None:
        target = values.target(out)
        values.copy(x, target)
        values.bind(out, target)
    updates = values.small(update)
    for position, first, window, valid in moves:
        if valid is False:
            continue
        at = [plus(code, s, w) for s, w in zip(first, window)]
        new = updates[position]
        if items is not None:
            _write_small(values, items, at, new, valid, combine)
        else:
            assert target is not None
            _write_memory(code, target, at, new, valid, combine, op)
    if items is not None:
        values.set(out, items)


def _merge(code: Code, old: Ref, new: Ref, hit: Ref | None, combine: str | None) -> Ref:
    if combine is not None:
        new = elementwise.RULES["add_any" if combine == "add" else combine](code, old, new)
    return new if hit is None else code.select(hit, new, old)


def _write_small(values: EmittedValues, items, at, new: Ref, valid, combine) -> None:
    code = values.code
    moving = [d for d, p in enumerate(at) if isinstance(p, Ref)]
    if not moving:
        items[tuple(at)] = _merge(code, items[tuple(at)], new, valid, combine)
        return
    flat, count = flat_index(code, items.shape, at, moving)
    for number in range(count):
        position, rest = list(at), number
        for d in reversed(moving):
            position[d] = rest % items.shape[d]
            rest //= items.shape[d]
        hit = compare(code, "eq", flat, code.constant(number, flat.dtype))
        hit = hit if valid is None else code.op("and", hit, valid)
        items[tuple(position)] = _merge(code, items[tuple(position)], new, hit, combine)


def _write_memory(code: Code, target: ArrayPlace, at, new: Ref, valid, combine, op: Op) -> None:
    if all(isinstance(p, int) for p in at):
        old = target.read(code, at)
        target.write(code, at, _merge(code, old, new, valid, combine))
        return
    if target.dtype == np.bool_:
        raise Unsupported(
            f"{op.name}: writing booleans at positions that are not constant, at {op.where}"
        )
    old = load(code, target, at)
    merged = code.splat(_merge(code, old, new, valid, combine), target.lanes)
    pointers, lanes, uniform = addresses(code, target, at)
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
    "dynamic_update_slice": _dynamic_update_slice,
    **dict.fromkeys(SCATTERS, _scatter),
}
