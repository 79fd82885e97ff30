"""Sums of gradients in float64 memory: of numbers, of arrays, of waiting rows, and over lanes."""

import math
from collections.abc import Callable

import numpy as np

from ..emit.code import Code
from ..emit.module import Ref
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues, fetch, nest
from ..program.program import BIG, ProgramValue


def ranges(
    code: Code, size: int, tile: int, body: Callable[[str, int], None], apart: bool = False
) -> None:
    """Calls `body` for every tile, the last one outside the loop if it is `apart`."""
    complete, rest = divmod(size, tile)
    if apart and not rest and complete:
        complete, rest = complete - 1, tile
    if complete == 1:
        body("0", tile)
    elif complete:
        with code.loop(complete) as loop:
            body(code.index(f"mul nsw i64 {loop.i}, {tile}"), tile)
    if rest:
        body(str(size - rest), rest)


def across(code: Code, vectors: list[Ref], width: int) -> list[Ref]:
    """Lane k of result n is the sum over the lanes of vector n * width + k."""
    vectors = list(vectors)
    zero = code.constant(0.0, vectors[0].dtype, width)
    while len(vectors) % width:
        vectors.append(zero)
    results = []
    for start in range(0, len(vectors), width):
        group = vectors[start : start + width]
        distance = width // 2
        while distance:
            half = len(group) // 2
            group = [_halve(code, a, b, distance) for a, b in zip(group[:half], group[half:])]
            distance //= 2
        results.append(group[0])
    return results


def _halve(code: Code, a: Ref, b: Ref, distance: int) -> Ref:
    """Lanes without the bit `distance` add up a's pairs, lanes with it b's."""
    keep = [m if not m & distance else a.lanes + m for m in range(a.lanes)]
    cross = [m ^ distance if not m & distance else a.lanes + (m ^ distance) for m in range(a.lanes)]
    return code.op("fadd", shuffle(code, a, b, keep), shuffle(code, a, b, cross))


def shuffle(code: Code, a: Ref, b: Ref, mask: list[int]) -> Ref:
    """Lanes of two vectors by number, those of `b` after those of `a`."""
    numbers = ", ".join(f"i32 {m}" for m in mask)
    text = f"shufflevector {a.type} {a.text}, {b.type} {b.text}, <{len(mask)} x i32> <{numbers}>"
    return Ref(code.raw(text), a.dtype, len(mask))


def pick(code: Code, totals: list[Ref], picks: list[int], width: int) -> Ref:
    """Some of the sums as one short vector."""
    parts = sorted({p // width for p in picks})
    first = totals[parts[0]]
    second = totals[parts[-1]]
    mask = [p % width if p // width == parts[0] else width + p % width for p in picks]
    return shuffle(code, first, second, mask)


def add_row(code: Code, at: str, sums: Ref, lanes: range) -> None:
    """Adds some lanes to float64 numbers that lie side by side."""
    x = shuffle(code, sums, sums, list(lanes))
    wide = x if x.dtype == "float64" else code.convert("fpext", x, "float64")
    old = Ref(code.raw(f"load {wide.type}, ptr {at}, align 8"), "float64", wide.lanes)
    new = code.op("fadd", old, wide)
    code.do(f"store {new.type} {new.text}, ptr {at}, align 8")


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
