"""Sine, cosine and the angle of two numbers."""

import math

from ..emit.module import Ref
from .arithmetic import Arithmetic

# (sin(r) - r) / r^3 and (cos(r) - 1 + r^2 / 2) / r^4 in r^2, for |r| <= pi / 4.
SIN = {
    "float32": (-0.16666664539365847, 0.008332724613783694, -0.000195828306788358),
    "float64": (
        -0.16666666666666666, 0.008333333333333331, -0.00019841269841264567, 2.7557319218954762e-06,
        -2.505210610025599e-08, 1.6058510875319195e-10, -7.585486485235938e-13,
    ),
}  # fmt: skip
COS = {
    "float32": (0.04166666453632113, -0.0013888279330556918, 2.4542871110870263e-05),
    "float64": (
        0.041666666666666664, -0.0013888888888888887, 2.4801587301584367e-05, -2.75573192211891e-07,
        2.0876755717584403e-09, -1.1470449354466773e-11, 4.745198807202876e-14,
    ),
}  # fmt: skip
# pi / 2 in three parts, each rounded to the type.
HALF_PI = {
    "float32": (1.57079637050628662109375, -4.37113900018624283e-8, -1.71512451306700468e-15),
    "float64": (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33),
}
LIMIT = {"float32": 1e5, "float64": 1e8}  # beyond, the C library reduces the argument
# (atan(r) - r) / r^3 in r^2, for |r| <= tan(pi / 8).
ATAN = {
    "float32": (
        -0.33333331746431516, 0.19999537099824088, -0.14263838476131002, 0.10742466849090754,
        -0.06447741047112404,
    ),
    "float64": (
        -0.3333333333333333, 0.199999999999998, -0.14285714285658824, 0.1111111110505757,
        -0.09090908748635232, 0.07692296234491514, -0.06666422364033206, 0.05878900032342983,
        -0.052302411507894, 0.045506220391755364, -0.034545610104858494, 0.016258132064979208,
    ),
}  # fmt: skip


def sin(a: Arithmetic, x: Ref) -> Ref:
    return _circular(a, x, 0, "llvm.sin")


def cos(a: Arithmetic, x: Ref) -> Ref:
    return _circular(a, x, 1, "llvm.cos")


def _circular(a: Arithmetic, x: Ref, turn: int, library: str) -> Ref:
    """sin(x + turn pi / 2): the nearest multiple of pi / 2 taken off, then a polynomial."""
    code, f = a.code, a.format
    shifted = code.fma(x, a.real(2 / math.pi), a.real(f.magic))
    n = code.op("fsub", shifted, a.real(f.magic))
    r = x
    for part in HALF_PI[f.dtype]:
        r = code.fma(n, a.real(-part), r)
    quarter = code.add(a.bits(shifted), a.integer(turn))
    square = code.op("fmul", r, r)
    sine = code.fma(code.op("fmul", r, square), a.polynomial(square, SIN[f.dtype]), r)
    fourth = code.op("fmul", square, square)
    cosine = code.fma(square, a.real(-0.5), a.real(1.0))
    cosine = code.fma(fourth, a.polynomial(square, COS[f.dtype]), cosine)
    odd = code.compare("ne", code.op("and", quarter, a.integer(1)), a.integer(0))
    result = code.select(odd, cosine, sine)
    width = 8 * (4 if f.dtype == "float32" else 8)
    sign = code.op("shl", code.op("and", quarter, a.integer(2)), a.integer(width - 2))
    fast = a.value(code.op("xor", a.bits(result), sign))
    if turn == 0:  # sin(-0) is -0
        fast = code.select(code.compare("oeq", x, a.real(0.0)), x, fast)
    return _beyond(a, x, fast, library)


def _beyond(a: Arithmetic, x: Ref, fast: Ref, library: str) -> Ref:
    """Where any lane is too large for the reduction, those lanes go to the C library."""
    code = a.code
    far = code.compare("ogt", code.call("llvm.fabs", x), a.real(LIMIT[a.format.dtype]))
    name = f"@llvm.vector.reduce.or.v{x.lanes}i1"
    code.module.declare(f"declare i1 {name}({far.type})")
    some = code.raw(f"call i1 {name}({far.type} {far.text})")
    before = code.block
    with code.branch(some):
        slow = code.select(far, code.call(library, x), fast)
        inner = code.block
    pairs = f"[ {fast.text}, %{before} ], [ {slow.text}, %{inner} ]"
    return Ref(code.raw(f"phi {fast.type} {pairs}"), fast.dtype, fast.lanes)


def atan2(a: Arithmetic, y: Ref, x: Ref) -> Ref:
    code = a.code
    ax, ay = code.call("llvm.fabs", x), code.call("llvm.fabs", y)
    steep = code.compare("ogt", ay, ax)
    low, high = code.select(steep, ax, ay), code.select(steep, ay, ax)
    t = code.div(low, code.select(code.compare("oeq", high, a.real(0.0)), a.real(1.0), high))
    t = code.select(code.compare("oeq", low, a.real(math.inf)), a.real(1.0), t)
    wide = code.compare("ogt", t, a.real(math.tan(math.pi / 8)))
    one = a.real(1.0)
    rotated = code.div(code.op("fsub", t, one), code.op("fadd", t, one))
    z = code.select(wide, rotated, t)
    square = code.op("fmul", z, z)
    series = a.polynomial(square, ATAN[a.format.dtype])
    angle = code.fma(code.op("fmul", z, square), series, z)
    angle = code.select(wide, code.op("fadd", angle, a.real(math.pi / 4)), angle)
    angle = code.select(steep, code.op("fsub", a.real(math.pi / 2), angle), angle)
    behind = code.compare("slt", a.bits(x), a.integer(0))
    angle = code.select(behind, code.op("fsub", a.real(math.pi), angle), angle)
    wrong = code.compare("uno", x, y)
    angle = code.select(wrong, a.real(math.nan), angle)
    return code.call("llvm.copysign", angle, y)
