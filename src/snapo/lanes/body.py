"""A program's operations, emitted region by region.

Arrays of up to `BIG` numbers live in registers and need no loop. Elementwise work on larger ones
is gathered into loops, so that only the arrays that another region reads go through memory.
"""

import math
from collections.abc import Container
from dataclasses import dataclass, field

import numpy as np

from . import ACCIDENTS, Unsupported
from .emit.code import Code
from .emit.module import Ref
from .emit.storage import ArrayPlace
from .emit.values import EmittedValues, fetch, nest, objects, put
from .program.program import BIG, Op, ProgramValue
from .program.sweeps import costly
from .rules import RULES, dots, elementwise

SHORT = 8  # operations of a loop that is written out for every sum of a dot product's tile


@dataclass(eq=False)
class Region:
    """Operations emitted together: one of any kind, or elementwise ones over `shape`."""

    ops: list[Op]
    shape: tuple[int, ...] | None = None
    stored: list[ProgramValue] = field(default_factory=list)
    dot: Op | None = None  # one whose sums go into this loop straight from their registers


def loops(op: Op) -> tuple[int, ...] | None:
    """The shape an elementwise operation loops over; None for other operations."""
    shape = op.outputs[0].shape
    if op.outputs[0].size <= BIG or not elementwise.supported(op.name):
        return None
    return shape


def regions(ops: list[Op], values: set[ProgramValue]) -> list[Region]:
    """Orders the operations; loops are postponed until nothing else can be done.

    `values` are values that must exist after the last region.
    """
    waiting, readers = {}, {}
    made = {v for op in ops for v in op.outputs}
    for op in ops:
        sources = {v for v in op.inputs if v in made}
        waiting[op] = len(sources)
        for v in sources:
            readers.setdefault(v, []).append(op)
    ready = [op for op in ops if not waiting[op]]
    result: list[Region] = []

    def finish(op: Op) -> None:
        ready.remove(op)
        for v in op.outputs:
            for reader in readers.get(v, []):
                waiting[reader] -= 1
                if not waiting[reader]:
                    ready.append(reader)

    while ready:
        single = next((op for op in ready if loops(op) is None), None)
        if single is not None:
            finish(single)
            result.append(Region([single]))
            continue
        shape = loops(ready[0])
        key = (shape, ready[0].outputs[0].path)
        group = []
        while True:
            op = next((o for o in ready if (loops(o), o.outputs[0].path) == key), None)
            if op is None:
                break
            finish(op)
            group.append(op)
        result.append(Region(group, shape))
    sink(result, readers, values)
    join(result, readers, values)
    for region in result:
        inside = set(region.ops)
        if region.shape is not None:
            region.stored = [
                v
                for op in region.ops
                for v in op.outputs
                if v in values or any(r not in inside for r in readers.get(v, []))
            ]
    return [region for region in result if region.ops]


def sink(order: list[Region], readers, values: set[ProgramValue]) -> None:
    """Moves an operation that only a later loop reads into that loop, to avoid memory."""
    home = {op: region for region in order for op in region.ops}
    for region in reversed(order):
        if region.shape is None:
            continue
        for op in reversed(region.ops):
            users = {home[r] for v in op.outputs for r in readers.get(v, [])}
            if len(users) != 1 or costly(op) or any(v in values for v in op.outputs):
                continue
            (user,) = users
            if user is not region and user.shape == region.shape:
                region.ops.remove(op)
                user.ops.insert(0, op)
                home[op] = user


def join(order: list[Region], readers, values: set[ProgramValue]) -> None:
    """Gives a short loop the dot product that only it reads, element by element."""
    home = {op: region for region in order for op in region.ops}
    for region in order:
        op = region.ops[0] if len(region.ops) == 1 else None
        if op is None or op.name != "dot_general" or not dots.tiles(op):
            continue
        (out,) = op.outputs
        users = {home[r] for r in readers.get(out, [])}
        if len(users) != 1 or out in values:
            continue
        (user,) = users
        short = len(user.ops) <= SHORT and not any(map(costly, user.ops))
        if short and user.shape == out.shape and user.dot is None:
            user.dot = op
            region.ops.remove(op)


REARRANGED = {"slice", "split", "reshape", "squeeze", "transpose"}  # finite where inputs are
INTERLEAVED = 4  # vector registers of neighbouring elements that a loop works on at once


def write(
    values: EmittedValues,
    ops: list[Op],
    requested: list[ProgramValue],
    loose: Container[ProgramValue] = (),
) -> None:
    """Writes all operations, then copies values to their homes.

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
            if op.name in REARRANGED and values.finite.issuperset(op.inputs):
                values.finite.update(op.outputs)
            for value in op.outputs:
                values.settle(value)


def single(values: EmittedValues, op: Op) -> None:
    """Writes one operation that shares no loop."""
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
    """One pass over the elements of arrays of the same shape. If the loop begins with a dot
    product, each sum is passed on in its register, unless an array of the loop is stored in
    another order.
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
    """The number of elements treated together: one chain of steps would leave the processor
    idle."""
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
