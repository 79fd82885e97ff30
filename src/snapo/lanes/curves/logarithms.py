"""Logarithms and powers."""

import math

from ..emit.module import Ref
from .arithmetic import Arithmetic
from .exponentials import exp

# float32: (log(1 + f) - f + f^2 / 2) / f^3. float64: log((1 + s) / (1 - s)) / s - 2 in s^2.
LOG32 = (
    0.33333331180030046, -0.24999996957950882, 0.200007157488921, -0.16667802319501254,
    0.1424905764569748, -0.12425687331451106, 0.1168541992348674, -0.11479733846637635,
    0.06971611471451178,
)  # fmt: skip
LOG64 = (
    0.6666666666666666, 0.4000000000000101, 0.2857142857072283, 0.2222222240984404,
    0.18181793722272505, 0.15386342974308154, 0.1326603503726105, 0.13114976096717038,
)  # fmt: skip


def split(a: Arithmetic, x: Ref) -> tuple[Ref, Ref]:
    """x = 2^e (1 + f) with 1 + f between sqrt(1/2) and sqrt(2): e as a number, and f."""
    code, f = a.code, a.format
    one = 0x3F800000 if f.dtype == "float32" else 0x3FF0000000000000
    shifted = code.add(a.bits(x), a.integer(one - f.half_root))
    e = code.sub(code.op("ashr", shifted, a.integer(f.mantissa)), a.integer(f.bias))
    mantissa = code.op("and", shifted, a.integer((1 << f.mantissa) - 1))
    m = a.value(code.add(mantissa, a.integer(f.half_root)))
    if f.integer == "int64":
        e = code.convert("trunc", e, "int32")
    return code.convert("sitofp", e, f.dtype), code.op("fsub", m, a.real(1.0))


def logarithm(a: Arithmetic, e: Ref, f: Ref, extra: Ref | None = None) -> Ref:
    """e ln 2 + log(1 + f) + extra, for a small `extra`."""
    code = a.code
    half = code.op("fmul", code.op("fmul", f, f), a.real(0.5))
    if a.format.dtype == "float32":
        cube = code.op("fmul", code.op("fmul", f, f), f)
        small = code.op("fmul", cube, a.polynomial(f, LOG32))
    else:
        s = code.div(f, code.op("fadd", f, a.real(2.0)))
        z = code.op("fmul", s, s)
        tail = code.op("fmul", z, a.polynomial(z, LOG64))
        small = code.op("fmul", s, code.op("fadd", half, tail))
    small = code.fma(e, a.real(a.format.ln2_low), small)
    if extra is not None:
        small = code.op("fadd", small, extra)
    small = code.op("fsub", small, half)
    return code.fma(e, a.real(a.format.ln2_high), code.op("fadd", f, small))


def log(a: Arithmetic, x: Ref) -> Ref:
    code, f = a.code, a.format
    denormal = code.compare("olt", x, a.real(f.normal))
    up = f.mantissa + 2
    e, rest = split(a, code.select(denormal, code.op("fmul", x, a.real(2.0**up)), x))
    shift = code.select(denormal, a.real(-float(up)), a.real(0.0))
    return _domain(a, x, 0.0, logarithm(a, code.op("fadd", e, shift), rest))


def log1p(a: Arithmetic, x: Ref) -> Ref:
    """log(u) + (1 + x - u) / u with u = 1 + x rounded."""
    code = a.code
    one = a.real(1.0)
    u = code.op("fadd", x, one)
    above = code.compare("oge", x, one)
    lost = code.select(
        above,
        code.op("fsub", one, code.op("fsub", u, x)),
        code.op("fsub", x, code.op("fsub", u, one)),
    )
    e, f = split(a, u)
    result = logarithm(a, e, f, code.div(lost, u))
    small = code.compare("olt", code.call("llvm.fabs", x), a.real(a.format.tiny))
    return code.select(small, x, _domain(a, x, -1.0, result))


def _domain(a: Arithmetic, x: Ref, pole: float, result: Ref) -> Ref:
    """Minus infinity at the pole, NaN below it, infinity at infinity."""
    code = a.code
    inside = code.compare("ogt", x, a.real(pole))
    at_pole = code.compare("oeq", x, a.real(pole))
    outside = code.select(at_pole, a.real(-math.inf), a.real(math.nan))
    infinite = code.compare("oeq", x, a.real(math.inf))
    return code.select(infinite, x, code.select(inside, result, outside))


def power(a: Arithmetic, x: Ref, y: Ref) -> Ref:
    """x^y: in float32 by logarithms in float64, in float64 by the C library."""
    code = a.code
    if a.format.dtype == "float64":
        return code.call("llvm.pow", x, y)
    size = code.call("llvm.fabs", x)
    wide = Arithmetic(code, "float64", a.lanes)
    exponent = code.op(
        "fmul",
        code.convert("fpext", y, "float64"),
        log(wide, code.convert("fpext", size, "float64")),
    )
    result = code.convert("fptrunc", exp(wide, exponent), "float32")
    half = code.op("fmul", y, a.real(0.5))
    complete = code.compare("oeq", code.call("llvm.trunc", y), y)
    odd = code.op("and", complete, code.compare("une", code.call("llvm.trunc", half), half))
    signed = code.call("llvm.copysign", result, x)
    result = code.select(odd, signed, result)
    negative = code.compare("olt", x, a.real(0.0))
    negative = code.op("and", negative, code.compare("ogt", x, a.real(-math.inf)))
    finite = code.compare("olt", code.call("llvm.fabs", y), a.real(math.inf))
    broken = code.op(
        "and",
        negative,
        code.op("and", finite, code.compare("une", code.call("llvm.trunc", y), y)),
    )
    result = code.select(broken, a.real(math.nan), result)
    unit = code.compare("oeq", size, a.real(1.0))
    infinite = code.compare("oeq", code.call("llvm.fabs", y), a.real(math.inf))
    positive = code.compare("ogt", x, a.real(0.0))
    certain = code.op("and", unit, code.op("or", positive, infinite))
    one = code.op("or", code.compare("oeq", y, a.real(0.0)), certain)
    return code.select(one, a.real(1.0), result)
