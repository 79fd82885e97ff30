"""Emits the straight-line body of one step: registers, loops, dot products, in a region's order."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from . import arrays, dots, elementwise
from .code import TYPES, Code, Ref, number
from .passes import BIG
from .program import Op, Unsupported, Value
from .schedule import Region, regions
from .storage import Place, Small, row_major

# What goes wrong while an operation is emitted is a reason to take another engine.
ACCIDENTS = (LookupError, AssertionError, TypeError, ValueError, NotImplementedError)
INTERLEAVED = 4  # vector registers of neighbouring elements that a loop works on at once


class Body:
    """Values of one program as they come into being inside one function.

    `homes` are places where given values must lie when the body ends (tape, chunk rows); an
    operation that writes memory writes there at once.
    """

    def __init__(self, code: Code, workspace: "Workspace", homes: dict[Value, Place] | None = None):
        self.code = code
        self.workspace = workspace
        self.homes = homes or {}
        self.where: dict[Value, Small | Place] = {}

    def run(self, ops: list[Op], wanted: list[Value]) -> None:
        """Emits everything, then brings values to their homes."""
        for value in list(self.where):
            self.settle(value)
        for region in regions(ops, set(wanted) | set(self.homes)):
            try:
                if region.shape is None:
                    self.single(region.ops[0])
                else:
                    self.loop(region)
            except ACCIDENTS as error:
                op = region.ops[0]
                reason = f"{op.name}: {type(error).__name__}: {error}, at {op.where}"
                raise Unsupported(reason) from error
            for op in region.ops:
                for value in op.outputs:
                    self.settle(value)

    def settle(self, value: Value) -> None:
        """Copies a value to its home where it is not there already."""
        home = self.homes.get(value)
        if home is None or value not in self.where or self.where[value] is home:
            return
        self.copy(value, home)
        if isinstance(self.where[value], Place):
            self.where[value] = home

    def lanes(self, value: Value) -> int:
        return self.code.lanes if value.path else 1

    # Reading.

    def get(self, value: Value) -> Small | Place:
        known = self.where.get(value)
        if known is None:
            assert value.constant is not None, "a value is read before it exists"
            known = self.where[value] = self.known(value)
        return known

    def known(self, value: Value) -> Small | Place:
        """A constant: registers where it is small or all the same, else a table in the kernel."""
        array = np.asarray(value.constant)
        if (array.size and np.all(array == array.flat[0])) or array.size == 1:
            ref = self.code.constant(array.flat[0], array.dtype)
            single = np.empty((1,) * array.ndim, object)
            single[...] = ref
            return Small(np.broadcast_to(single, array.shape))
        if array.size <= BIG:
            return Small(
                _objects([self.code.constant(x, array.dtype) for x in array.flat], array.shape)
            )
        base = self.code.module.table(array)
        return Place(base, 0, array.shape, row_major(array.shape), array.dtype, 1, True)

    def small(self, value: Value) -> Any:
        """The elements as registers, loaded if they lie in memory."""
        known = self.get(value)
        if isinstance(known, Place):
            refs = [known.read(self.code, list(map(int, p))) for p in np.ndindex(*known.shape)]
            known = Small(_objects(refs, known.shape))
            if value.size <= 4 * BIG:
                self.where[value] = known
        return known.items

    def place(self, value: Value) -> Place:
        """The array in memory, stored there if it lies in registers."""
        known = self.get(value)
        if isinstance(known, Place):
            return known
        home = self.homes.get(value)
        if home is None:
            home = self.workspace.allocate(known.shape, value.dtype, self.width(known))
            self.copy(value, home)
        return home

    def width(self, small: Small) -> int:
        return (
            max((r.lanes for r in small.items.flat), default=1)
            if small.uniform is None
            else small.uniform.lanes
        )

    def operand(self, value: Value, shape: tuple[int, ...]) -> Ref | Place:
        """What a loop over `shape` reads: one register for all, or memory."""
        known = self.get(value)
        if isinstance(known, Small) and known.uniform is not None:
            return known.uniform
        return self.place(value).broadcast(shape)

    # Writing.

    def set(self, value: Value, items: np.ndarray | Ref) -> None:
        """Registers for a value; NumPy gives a bare element where an array has no axes."""
        if isinstance(items, Ref):
            items = _objects([items], ())
        self.where[value] = Small(items)

    def target(self, value: Value) -> Place:
        """Memory for a new array: its home, or the workspace."""
        home = self.homes.get(value)
        return home or self.workspace.allocate(value.shape, value.dtype, self.lanes(value))

    def copy(self, value: Value, target: Place) -> None:
        known = self.get(value)
        if (isinstance(known, Small) and known.uniform is None) or known_size(known) <= BIG:
            for p in np.ndindex(*target.shape):
                ref = (
                    known.items[p]
                    if isinstance(known, Small)
                    else known.read(self.code, list(map(int, p)))
                )
                target.write(self.code, list(map(int, p)), ref)
            return
        source = self.operand(value, value.shape)
        with nest(self.code, value.shape, [source, target]) as position:
            target.write(self.code, position, fetch(self.code, source, position))

    # Operations.

    def single(self, op: Op) -> None:
        if elementwise.supported(op.name):
            shape = op.outputs[0].shape
            inputs = [self.small(v) for v in op.inputs]
            inputs = [i if i.shape == shape else np.broadcast_to(i, shape) for i in inputs]
            if all(_repeats(i) for i in inputs) and inputs and math.prod(shape) > 1:
                one = elementwise.apply(self.code, op, [i.flat[0] for i in inputs])
                self.set(op.outputs[0], np.broadcast_to(_objects([one], (1,) * len(shape)), shape))
                return
            refs = [
                elementwise.apply(self.code, op, list(args))
                for args in zip(*(i.flat for i in inputs))
            ]
            self.set(op.outputs[0], _objects(refs, shape))
        elif op.name == "dot_general":
            dots.dot(self, op)
        else:
            rule = arrays.RULES.get(op.name)
            if rule is None:
                raise Unsupported(f"{op.name}, at {op.where}")
            rule(self, op)

    def loop(self, region: Region) -> None:
        """One pass over the elements of equally shaped arrays.

        A dot product that the loop begins with hands over each sum as it leaves its registers,
        unless an array of the loop is stored in another order.
        """
        code, shape = self.code, region.shape
        assert shape is not None
        inside = {v for op in region.ops for v in op.outputs}
        outside = dict.fromkeys(v for op in region.ops for v in op.inputs if v not in inside)
        sums = region.dot.outputs if region.dot else []
        sources = {v: self.operand(v, shape) for v in outside if v not in sums}
        targets = {v: self.target(v) for v in region.stored}
        front = [0] * (len(shape) - 1)

        def round(position: list[int | str], width: int, *given: Ref) -> None:
            refs = dict(zip(sums, given))
            refs |= {v: fetch(code, s, position, width) for v, s in sources.items()}
            for op in region.ops:
                refs[op.outputs[0]] = elementwise.apply(code, op, [refs[v] for v in op.inputs])
            for v, target in targets.items():
                put(code, target, position, refs[v], width)

        if region.dot and _in_order(sources, targets, shape):
            dots.dot(self, region.dot, lambda i, total: round([*front, i], 1, total))
            self.where.update(targets)
            return
        if region.dot:
            self.single(region.dot)
            sources |= {v: self.operand(v, shape) for v in sums}
            sums = []
        count = math.prod(shape)
        wide = self.interleaved(region) if _in_order(sources, targets, shape) else 1
        if wide > 1 and count >= wide:
            with code.loop(count // wide) as loop:
                round([*front, code.index(f"mul nsw i64 {loop.i}, {wide}")], wide)
            for i in range(count - count % wide, count):
                round([*front, i], 1)
        else:
            with nest(code, shape, [*sources.values(), *targets.values()]) as position:
                round(position, 1)
        self.where.update(targets)

    def interleaved(self, region: Region) -> int:
        """Elements worked on side by side: one chain of steps would idle the processor."""
        widths = [np.dtype(v.dtype).itemsize for op in region.ops for v in op.outputs]
        value = region.ops[0].outputs[0]
        if not value.path or any(v.dtype == np.bool_ for v in region.stored):
            return 1
        registers = max(1, self.code.lanes * max(widths) // self.code.module.register)
        return max(1, INTERLEAVED // registers)


class Workspace:
    """Scratch memory of one thread: where arrays lie between two regions."""

    def __init__(self, base: str = "%c_work"):
        self.base = base
        self.size = 0

    def allocate(self, shape, dtype, lanes: int) -> Place:
        place = Place(
            self.base, self.size, tuple(shape), row_major(tuple(shape)), np.dtype(dtype), lanes
        )
        self.size += -(-math.prod(shape) * place.unit // 64) * 64
        return place


def fetch(code: Code, source: Ref | Place, position, width: int = 1) -> Ref:
    """One element, or `width` neighbours as one long vector of lanes."""
    if isinstance(source, Ref):
        return source if source.lanes == 1 or width == 1 else code.join([source] * width)
    if width == 1:
        return source.read(code, position)
    if source.lanes > 1 and source.dtype != np.bool_:
        return code.load(source.address(code, position), source.dtype, source.lanes * width)
    *front, last = position
    parts = [source.read(code, position)]
    parts += [
        source.read(code, [*front, code.index(f"add nsw i64 {last}, {i}")]) for i in range(1, width)
    ]
    return code.join([code.splat(p, code.lanes) for p in parts])


def put(code: Code, target: Place, position, x: Ref, width: int) -> None:
    """Stores what `fetch` would read."""
    if width == 1:
        target.write(code, position, x)
    else:
        code.store(x, target.address(code, position), target.lanes * width)


class nest:
    """Loops over all positions of `shape`; one loop where every array is stored in order."""

    def __init__(self, code: Code, shape, operands):
        places = [p for p in operands if isinstance(p, Place)]
        self.code, self.shape = code, shape
        self.flat = all(p.contiguous and p.shape == shape for p in places) and len(shape) > 1
        self.flat = self.flat and all(math.prod(shape) > 1 for _ in places)
        self.open = []

    def __enter__(self) -> list[int | str]:
        if self.flat:
            loop = self.code.loop(math.prod(self.shape))
            counter = loop.__enter__()
            self.open.append(loop)
            return [0] * (len(self.shape) - 1) + [counter.i]
        position: list[int | str] = []
        for size in self.shape:
            if size == 1:
                position.append(0)
                continue
            loop = self.code.loop(size)
            position.append(loop.__enter__().i)
            self.open.append(loop)
        return position

    def __exit__(self, *error) -> None:
        if error[0] is None:
            for loop in reversed(self.open):
                loop.__exit__(None, None, None)


def known_size(known: Small | Place) -> int:
    return math.prod(known.shape)


def _in_order(sources, targets, shape) -> bool:
    """Whether all arrays of a loop lie in memory one element after the other."""
    places = [p for p in [*sources.values(), *targets.values()] if isinstance(p, Place)]
    return all(p.contiguous and p.shape == shape for p in places)


def _objects(refs: list[Ref], shape) -> np.ndarray:
    array = np.empty(len(refs), object)
    for i, ref in enumerate(refs):
        array[i] = ref
    return array.reshape(shape)


def _repeats(items: np.ndarray) -> bool:
    return items.size == 1 or not any(s for s, n in zip(items.strides, items.shape) if n > 1)


__all__ = ["TYPES", "Body", "Workspace", "fetch", "nest", "number", "replace"]
