"""Sums over the lanes of many vectors at once, and the rows of float64 numbers they go to."""

from ..emit.code import Code
from ..emit.ref import Ref


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
