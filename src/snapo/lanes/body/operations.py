"""Writes a program's operations, region by region."""

import math
from collections.abc import Container

import numpy as np

from ..emit.code import Code
from ..emit.nest import fetch, nest, put
from ..emit.ref import Ref
from ..emit.storage import ArrayPlace
from ..emit.values import EmittedValues, objects
from ..program.program import Op, ProgramValue
from ..rules import dots, elementwise
from ..rules.catalogue import RULES
from ..unsupported import ACCIDENTS, Unsupported
from .regions import Region, regions

INTERLEAVED = 4  # vector registers of neighbouring elements that a loop works on at once


def write(
    values: EmittedValues,
    ops: list[Op],
    requested: list[ProgramValue],
    loose: Container[ProgramValue] = (),
) -> None:
    """Writes all operations, then brings values to their homes.

    The bits of `loose` values may depend on those around them (see `Code`).
    """
    values.loose = loose
    values.settle_all()
    for region in regions(ops, set(requested) | set(values.homes)):
        try:
            if region.shape is None:
                single(values, region.ops[0])
            else:
                loop(values, region, region.shape)
        except ACCIDENTS as error:
            op = region.ops[0]
            reason = f"{op.name}: {type(error).__name__}: {error}, at {op.where}"
            raise Unsupported(reason) from error
        for op in region.ops:
            for value in op.outputs:
                values.settle(value)


def single(values: EmittedValues, op: Op) -> None:
    """One operation, without a loop that it would share."""
    if elementwise.supported(op.name):
        _by_element(values, op)
        return
    rule = RULES.get(op.name)
    if rule is None:
        raise Unsupported(f"{op.name}, at {op.where}")
    rule(values, op)


def _by_element(values: EmittedValues, op: Op) -> None:
    """An elementwise operation in registers; done once where all elements are the same."""
    code, (out, *_) = values.code, op.outputs
    inputs = [values.small(v) for v in op.inputs]
    inputs = [i if i.shape == out.shape else np.broadcast_to(i, out.shape) for i in inputs]
    if all(_repeats(i) for i in inputs) and inputs and out.size > 1:
        one = elementwise.apply(code, op, [i.flat[0] for i in inputs])
        values.set(out, np.broadcast_to(objects([one], (1,) * len(out.shape)), out.shape))
        return
    code.contract = out in values.loose
    refs = [elementwise.apply(code, op, list(args)) for args in zip(*(i.flat for i in inputs))]
    code.contract = False
    values.set(out, objects(refs, out.shape))


def loop(values: EmittedValues, region: Region, shape: tuple[int, ...]) -> None:
    """One pass over the elements of equally shaped arrays.

    A dot product that the loop begins with hands over each sum as it leaves its registers,
    unless an array of the loop is stored in another order.
    """
    code = values.code
    inside = {v for op in region.ops for v in op.outputs}
    outside = dict.fromkeys(v for op in region.ops for v in op.inputs if v not in inside)
    sums = region.dot.outputs if region.dot else []
    sources = {v: values.operand(v, shape) for v in outside if v not in sums}
    targets = {v: values.target(v) for v in region.stored}
    front = [0] * (len(shape) - 1)

    def round(position: list[int | str], width: int, *ref: Ref) -> None:
        refs = dict(zip(sums, ref))
        refs |= {v: fetch(code, s, position, width) for v, s in sources.items()}
        for op in region.ops:
            code.contract = op.outputs[0] in values.loose
            refs[op.outputs[0]] = elementwise.apply(code, op, [refs[v] for v in op.inputs])
            code.contract = False
        for v, target in targets.items():
            put(code, target, position, refs[v], width)

    if region.dot and _in_order(sources, targets, shape):
        dots.dot(values, region.dot, lambda i, total: round([*front, i], 1, total))
    else:
        if region.dot:
            single(values, region.dot)
            sources |= {v: values.operand(v, shape) for v in sums}
            sums = []
        count = math.prod(shape)
        wide = interleaved(code, region) if _in_order(sources, targets, shape) else 1
        if wide > 1 and count >= wide:
            with code.loop(count // wide) as item:
                round([*front, code.index(f"mul nsw i64 {item.i}, {wide}")], wide)
            for i in range(count - count % wide, count):
                round([*front, i], 1)
        else:
            with nest(code, shape, [*sources.values(), *targets.values()]) as position:
                round(position, 1)
    for v, target in targets.items():
        values.bind(v, target)


def interleaved(code: Code, region: Region) -> int:
    """Elements worked on side by side: one chain of steps would idle the processor."""
    widths = [np.dtype(v.dtype).itemsize for op in region.ops for v in op.outputs]
    value = region.ops[0].outputs[0]
    if not value.path or any(v.dtype == np.bool_ for v in region.stored):
        return 1
    registers = max(1, code.lanes * max(widths) // code.module.register)
    return max(1, INTERLEAVED // registers)


def _in_order(sources, targets, shape) -> bool:
    """Whether all arrays of a loop lie in memory one element after the other."""
    positions = [p for p in [*sources.values(), *targets.values()] if isinstance(p, ArrayPlace)]
    return all(p.contiguous and p.shape == shape for p in positions)


def _repeats(items: np.ndarray) -> bool:
    return items.size == 1 or not any(s for s, n in zip(items.strides, items.shape) if n > 1)
