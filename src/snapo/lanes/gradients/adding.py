"""Sums of gradients in float64 memory: of numbers, of arrays, and of waiting rows."""

import math

import numpy as np

from ..emit.code import Code
from ..emit.nest import fetch, nest
from ..emit.ref import Ref
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues
from ..program.program import BIG, ProgramValue
from .ranges import ranges


def add(values: EmittedValues, value: ProgramValue, target: ArrayPlace) -> None:
    """Adds a value, summed over lanes, to float64 memory of the same shape."""
    if value.constant is not None and not np.any(value.constant):
        return
    code, available = values.code, values.get(value)
    if isinstance(available, Small) and (value.size <= BIG or available.uniform is None):
        for p in np.ndindex(*value.shape):
            add_number(code, target, list(p), available.items[p])
        return
    source = values.operand(value, value.shape)
    with nest(code, value.shape, [source, target]) as position:
        add_number(code, target, position, fetch(code, source, position))


def add_number(code: Code, target: ArrayPlace, position, x: Ref) -> None:
    """Adds a number, summed over lanes, to one element of float64 memory."""
    if x.value is not None and x.value == 0:
        return
    target.write(code, position, code.add(target.read(code, position), total(code, x)))


def total(code: Code, x: Ref) -> Ref:
    """The sum over lanes, in float64."""
    wide = x if x.dtype == "float64" else code.convert("fpext", x, "float64")
    if wide.lanes == 1:
        return wide
    name = f"@llvm.vector.reduce.fadd.v{wide.lanes}f64"
    code.module.declare(f"declare double {name}(double, {wide.type})")
    scalar = code.raw(f"call reassoc double {name}(double -0.0, {wide.type} {wide.text})")
    return Ref(code.raw(f"insertelement <1 x double> poison, double {scalar}, i64 0"), "float64", 1)


def add_rows(code: Code, position: ArrayPlace, stride: str, count: str, target: ArrayPlace) -> None:
    """Adds every element's sum over lanes and steps, some elements side by side."""
    size = math.prod(position.shape)
    flat = ArrayPlace(position.base, position.offset, (size,), (1,), position.dtype, position.lanes)
    into = ArrayPlace(target.base, target.offset, (size,), (1,), target.dtype, 1)

    def some(first: str, number: int) -> None:
        start = flat.address(code, [first])
        zeros = tuple(code.constant(0.0, position.dtype, position.lanes) for _ in range(number))
        with code.loop(count, zeros) as loop:
            row = code.pointer(start, code.index(f"mul nsw i64 {loop.i}, {stride}"))
            loop.results = [
                code.op(
                    "fadd",
                    total,
                    code.load(code.pointer(row, k * flat.unit), position.dtype, position.lanes),
                )
                for k, total in enumerate(loop.carried)
            ]
        for k, result in enumerate(loop.results):
            add_number(code, into, [code.index(f"add nsw i64 {first}, {k}")], result)

    ranges(code, size, 4, some)
