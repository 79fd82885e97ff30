"""Normals drawn inside the kernel: the words and the inverse normal of `snapo.scenarios`.

Threefry-2x32 with 20 rounds (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as
1, 2, 3", SC 2011) and Wichura's AS241. The words are bit-identical to those of `scenarios`.
"""

import numpy as np

from ...scenarios import _PPND7, _PPND16
from .code import Code, Ref
from .math import Curve

ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def threefry(code: Code, key: tuple[Ref, Ref], counter: tuple[Ref, Ref]) -> tuple[Ref, Ref]:
    """Two random words per lane from a key and a counter of two words."""
    parity = code.constant(0x1BD11BDA, "uint32")
    keys = [key[0], key[1], code.op("xor", code.op("xor", key[0], key[1]), parity)]
    x, y = code.add(counter[0], keys[0]), code.add(counter[1], keys[1])
    for group in range(5):
        for turn in ROTATIONS[group % 2]:
            x = code.add(x, y)
            y = code.op("xor", _rotate(code, y, turn), x)
        x = code.add(x, keys[(group + 1) % 3])
        y = code.add(y, code.add(keys[(group + 2) % 3], code.constant(group + 1, "uint32")))
    return x, y


def _rotate(code: Code, x: Ref, turn: int) -> Ref:
    return code.call("llvm.fshl", x, x, code.constant(turn, x.dtype, x.lanes))


def normal(code: Code, word: Ref, dtype: str) -> Ref:
    """`scenarios.normal`, operation by operation."""
    curve = Curve(code, dtype, word.lanes)
    centre, outer = _PPND16 if dtype == "float64" else _PPND7
    mask = code.constant(0x7FFFFFFF, "uint32", word.lanes)
    m = code.op("and", word, mask)
    tail = code.op("fadd", code.convert("sitofp", m, dtype), curve.real(0.5))
    tail = code.op("fmul", tail, curve.real(2.0**-32))
    rest = code.convert("sitofp", code.op("sub", mask, m), dtype)
    q = code.fma(rest, curve.real(2.0**-32), curve.real(2.0**-33))
    inner = code.fma(code.op("fneg", q), q, curve.real(0.180625))
    logarithm = curve.logarithm(*curve.split(tail))  # a tail is positive and never denormal
    root = code.call("llvm.sqrt", code.op("fneg", logarithm))
    far = code.op("fsub", root, curve.real(1.6))
    # One division serves both branches: numerator and denominator are selected first.
    near = code.compare("ole", q, curve.real(0.425))
    top = code.select(
        near,
        code.op("fmul", q, curve.polynomial(inner, centre[0])),
        curve.polynomial(far, outer[0]),
    )
    bottom = code.select(near, curve.polynomial(inner, centre[1]), curve.polynomial(far, outer[1]))
    z = code.div(top, bottom)
    sign = code.op("and", word, code.constant(0x80000000, "uint32", word.lanes))
    return _flip(code, z, sign, dtype)


def _flip(code: Code, z: Ref, sign: Ref, dtype: str) -> Ref:
    """z with its sign bit exchanged where the top bit of `sign` is set."""
    if dtype == "float64":
        sign = code.op(
            "shl", code.convert("zext", sign, "uint64"), code.constant(32, "uint64", z.lanes)
        )
    bits = code.convert("bitcast", z, sign.dtype)
    return code.convert("bitcast", code.op("xor", bits, sign), dtype)


def draw(
    code: Code,
    key: tuple[Ref, Ref],
    paths: Ref,
    step: Ref,
    size: int,
    dtype: str,
    antithetic: bool,
    put,
):
    """`size` normals of one step for the lanes' paths; `put(position, normal)` stores each.

    More than two pairs are drawn in a loop, two at a time.
    """
    one = code.constant(1, "uint32")
    number = code.op("lshr", paths, one) if antithetic else paths
    odd = code.op("shl", paths, code.constant(31, "uint32")) if antithetic else None
    pairs = (size + 1) // 2
    first = code.mul(step, code.constant(pairs, "uint32"))

    def normals(counters: list[Ref]) -> list[Ref]:
        """The pairs of several counters, worked on side by side."""
        lanes, count = paths.lanes, len(counters)
        words = min(2 * count, size)
        wide = code.join([code.splat(c, lanes) for c in counters])
        x, y = threefry(code, key, (code.join([number] * count), wide))
        parts = [code.part(w, j, lanes) for j in range(count) for w in (x, y)][:words]
        z = normal(code, code.join(parts), dtype)
        if odd is not None:
            z = _flip(code, z, code.join([odd] * words), dtype)
        return [code.part(z, i, lanes) for i in range(words)]

    def ahead(j: int, base: Ref) -> Ref:
        return code.add(base, code.constant(j, "uint32")) if j else base

    if pairs <= 2:
        drawn = normals([ahead(j, first) for j in range(pairs)])
        for i in range(size):
            put(i, drawn[i])
        return
    whole = size // 4
    with code.loop(whole) as loop:
        text = code.raw(f"trunc i64 {loop.i} to i32")
        base = code.add(first, code.mul(vector(code, text), code.constant(2, "uint32")))
        start = code.index(f"shl i64 {loop.i}, 2")
        for i, z in enumerate(normals([base, ahead(1, base)])):
            put(code.index(f"add i64 {start}, {i}"), z)
    rest = range(4 * whole, size)
    if rest:
        drawn = normals([ahead(j, first) for j in range(2 * whole, pairs)])[: len(rest)]
        for i in rest:
            put(i, drawn[i - 4 * whole])


def vector(code: Code, scalar: str, dtype: str = "uint32") -> Ref:
    """A scalar register as a vector of one lane."""
    kind = "i32" if np.dtype(dtype).itemsize == 4 else "i64"
    return Ref(code.raw(f"insertelement <1 x {kind}> poison, {kind} {scalar}, i64 0"), dtype, 1)
