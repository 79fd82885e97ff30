"""Regions and order: which operations share one loop over an array's elements.

Arrays of up to `BIG` numbers live in registers and need no loop. Elementwise work on larger ones
is gathered into loops, so that only the arrays that another region reads go through memory.
"""

from dataclasses import dataclass, field

from ..program.program import BIG, Op, ProgramValue
from ..program.sweeps import costly
from ..rules import dots, elementwise

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
    """Orders the operations; loops are put off until nothing else can go on.

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
    """Moves an operation that only a later loop reads into that loop, past memory."""
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
    """Gives a short loop the dot product that it alone reads, element by element."""
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
