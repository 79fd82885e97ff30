"""The noise of a phase: drawn from a counter inside the kernel, or given by the caller."""

import numpy as np

from snapo.lanes.emit.storage import ArrayPlace, row_major
from snapo.lanes.emit.values import EmittedValues, objects
from snapo.lanes.program.program import BIG, ProgramValue

from . import draw
from .context import field
from .sweep import KernelSweep


def bind(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Binds this step's noise, drawn or given."""
    if not s.build.traced.setup.counter:
        _supplied(s, values, value)
    elif not value.size:
        values.set(value, np.empty(value.shape, object))
    else:
        _drawn(s, values, value)


def _drawn(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Normals of some steps at once, into scratch memory; the step's own are a row of it."""
    code, size = s.code, value.size
    steps = 1 if s.initial else draw.ahead(size)
    rows = steps * size + draw.SPARE
    out = values.workspace.allocate((rows,), value.dtype, code.lanes)
    text = values.workspace.allocate((rows,), np.uint32, code.lanes)
    antithetic = s.build.traced.setup.antithetic
    name = draw.draw_function(code.module, size, value.dtype.name, antithetic)
    key = code.pointer(field("keys"), 8 if s.initial else 0)
    lanes = code.index(f"mul nsw i64 %block, {4 * code.lanes}")
    paths = code.pointer(field("paths"), lanes)

    def write(first: str, count: str) -> None:
        code.do(
            f"call void @{name}(ptr {key}, ptr {paths}, i64 {first}, i64 {count}, "
            f"ptr {code.pointer(out.base, out.offset)}, "
            f"ptr {code.pointer(text.base, text.offset)})"
        )

    if s.initial:
        write("0", "1")
        base = out.base
    else:
        relative = code.index(f"sub nsw i64 {s.t}, %begin")
        slot = code.index(f"and i64 {relative}, {steps - 1}")
        with code.branch(code.index(f"icmp eq i64 {slot}, 0")):
            left = code.index(f"sub nsw i64 %end, {s.t}")
            below = code.index(f"icmp slt i64 {left}, {steps}")
            first = code.index(f"add nsw i64 {s.t}, {field('first')}")
            write(first, code.index(f"select i1 {below}, i64 {left}, i64 {steps}"))
        row = code.index(f"mul nsw i64 {slot}, {size * out.unit}")
        base = code.pointer(out.base, row)
    shape = value.shape
    position = ArrayPlace(base, out.offset, shape, row_major(shape), value.dtype, code.lanes)
    values.bind(value, position)


def _supplied(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Given numbers [steps, paths, size], gathered from where the caller has them."""
    code, size = s.code, value.size
    unit = value.dtype.itemsize
    row = code.index(f"mul nsw i64 {s.t}, {field('count')}")
    slot = field("noise_initial" if s.initial else "noise")
    base = code.pointer(slot, code.index(f"mul nsw i64 {row}, {size * unit}"))
    lanes = code.index(f"mul nsw i64 %block, {8 * code.lanes}")
    position = code.load(code.pointer(field("positions"), lanes), "int64", code.lanes, True)
    offsets = code.mul(position, code.constant(size * unit, "int64"))
    if size <= BIG:
        refs = [
            code.gather(code.pointer(base, k * unit), offsets, value.dtype) for k in range(size)
        ]
        values.set(value, objects(refs, value.shape))
        return
    location = values.target(value)
    with code.loop(size) as loop:
        here = code.pointer(base, code.index(f"mul nsw i64 {loop.i}, {unit}"))
        location.write(code, [loop.i], code.gather(here, offsets, value.dtype))
    values.bind(value, location)
