"""Exponentials, and the error function made from them."""

import math

from ..emit.module import Ref
from .arithmetic import Arithmetic

# (exp(r) - 1 - r) / r^2 on half an octave around 0.
EXP = {
    "float32": (
        0.5, 0.16666569628115477, 0.04166654542109553, 0.00836438069329107, 0.0013927684616575004,
    ),
    "float64": (
        0.5, 0.16666666666666666, 0.04166666666666668, 0.008333333333333335, 0.0013888888888877397,
        0.00019841269841262181, 2.480158734081826e-05, 2.7557319250135434e-06,
        2.755725868862393e-07,
        2.5052068034668043e-08, 2.0919802534908384e-09, 1.6087737571667883e-10,
    ),
}  # fmt: skip
# tanh(x) / x as a ratio of polynomials in x^2 up to the x from which the nearest number is 1:
# minimax (2e-8), then the neighbours in float32 that round best.
TANH32 = 9.02, (
    1.0, 0.13382688164710999, 0.003497461322695017, 2.0635883629438467e-05, 1.3384359398571632e-08,
), (
    1.0, 0.46716001629829407, 0.02588437683880329, 0.0003288522711955011, 7.79027971020696e-07,
)  # fmt: skip
# tanh(y) / y in y^2 for |y| < ln 2 / 4: the sixth convergent of its continued fraction.
TANH64 = (10395.0, 1260.0, 21.0), (10395.0, 4725.0, 210.0, 1.0)


def growth(a: Arithmetic, r: Ref) -> Ref:
    """exp(r) - 1 for small r."""
    return a.code.fma(a.code.mul(r, r), a.polynomial(r, EXP[a.format.dtype]), r)


def exp(a: Arithmetic, x: Ref) -> Ref:
    """1 + growth, with n added to its exponent; zero instead of denormals."""
    code, f = a.code, a.format
    if f.dtype == "float32":
        shifted, r = a.octaves(x)
        risen = growth(a, r)
    else:
        # Twice p / (q - p), with p / q the hyperbolic tangent of half of the remainder.
        shifted, y = a.octaves(code.op("fmul", x, a.real(0.5)), 0.5)
        p, q = tangent(a, y)
        risen = code.div(code.op("fadd", p, p), code.op("fsub", q, p))
    near_one = a.bits(code.op("fadd", risen, a.real(1.0)))
    octaves = code.op("shl", a.bits(shifted), a.integer(f.mantissa))
    result = a.value(code.add(near_one, octaves))
    outside = code.op("fadd", x, a.real(math.inf))  # NaN for NaN
    result = code.select(code.compare("ugt", x, a.real(f.largest)), outside, result)
    return code.select(code.compare("olt", x, a.real(f.smallest)), a.real(0.0), result)


def tangent(a: Arithmetic, y: Ref) -> tuple[Ref, Ref]:
    """p and q with p / q = tanh(y), for |y| < ln 2 / 4 in float64."""
    square = a.code.op("fmul", y, y)
    p = a.code.op("fmul", y, a.polynomial(square, TANH64[0]))
    return p, a.polynomial(square, TANH64[1])


def expm1(a: Arithmetic, x: Ref) -> Ref:
    """2^n (exp(r) - 1) + 2^n - 1, at half size so that 2^n does not overflow."""
    code, f = a.code, a.format
    shifted, r = a.octaves(a.clamp(x, -f.mantissa - 10.0, math.ceil(f.largest)))
    p = growth(a, r)
    scale = a.power_of_two(shifted, 1)
    complete = code.fma(scale, p, code.op("fsub", scale, a.real(0.5)))
    complete = code.op("fadd", complete, complete)
    result = code.select(code.compare("oeq", shifted, a.real(f.magic)), p, complete)
    return code.call("llvm.copysign", result, x)


def tanh(a: Arithmetic, x: Ref) -> Ref:
    """A ratio of polynomials: in x for float32, and for float64 in the remainder of x after
    multiples of ln 2 / 2.

    With |x| = n ln 2 / 2 + y and tanh(y) = p / q the answer is
    ((2^n - 1) q + (2^n + 1) p) / ((2^n + 1) q + (2^n - 1) p).
    """
    code, f = a.code, a.format
    if f.dtype == "float32":
        end, top, bottom = TANH32
        x = a.clamp(x, -end, end)
        square = code.op("fmul", x, x)
        top = code.op("fmul", x, a.polynomial(square, top))
        return a.clamp(code.div(top, a.polynomial(square, bottom)), -1.0, 1.0)
    size = a.clamp(code.call("llvm.fabs", x), None, 20.0)  # where the answer is 1
    shifted, y = a.octaves(size, 0.5)
    scale, (p, q) = a.power_of_two(shifted), tangent(a, y)
    less, more = (code.op(o, scale, a.real(1.0)) for o in ("fsub", "fadd"))
    top = code.fma(less, q, code.op("fmul", more, p))
    bottom = code.fma(more, q, code.op("fmul", less, p))
    return code.call("llvm.copysign", code.div(top, bottom), x)


def logistic(a: Arithmetic, x: Ref) -> Ref:
    """1 / (1 + exp(-x)), from exp(-|x|) so that the small tail keeps its digits."""
    code = a.code
    e = exp(a, code.op("fneg", code.call("llvm.fabs", x)))
    top = code.select(code.compare("olt", x, a.real(0.0)), e, a.real(1.0))
    return code.div(top, code.op("fadd", e, a.real(1.0)))


# erf(x) / x in x^2 for |x| < 1, and erfc(x) exp(x^2) in (x - k) / (x + k) beyond.
ERF = {
    "float32": (
        1.1283791658483509, -0.37612626666720334, 0.11283594715160218, -0.026854212010626412,
        0.005189087423433974, -0.000801686428716587, 7.875875062685488e-05,
    ),
    "float64": (
        1.1283791670955126, -0.3761263890318375, 0.11283791670954879, -0.026866170645076792,
        0.0052239776248180145, -0.000854832698083379, 0.0001205533111164271,
        -1.4925595266831182e-05,
        1.6461000484121368e-06, -1.6350312701054695e-07, 1.4659775274047436e-08,
        -1.1372848856791674e-09, 5.957176147748911e-11,
    ),
}  # fmt: skip
ERFC = {
    "float32": (2.0, 4.2, (
        0.25539567621539094, -0.42718584823155614, 0.2416582184679889, -0.07897846495278252,
        0.003731934179645961, 0.006993588641245501, -0.0008351922478528371, -0.0009366758146284411,
    )),
    "float64": (3.0, 6.2, (
        0.17900115118138996, -0.3262335600430372, 0.24560380171233087, -0.15011593650077568,
        0.07166583719797799, -0.02439249931879729, 0.004269136332843161, 0.0007077464435634198,
        -0.0005970619475638154, 4.5255206664490134e-05, 6.405651007407599e-05,
        -1.2859462809128376e-05, -7.977320146623843e-06, 2.1134096515353967e-06,
        1.2454867861347614e-06, -2.720348541412093e-07, -2.056156175172263e-07,
    )),
}  # fmt: skip


def erf(a: Arithmetic, x: Ref) -> Ref:
    code = a.code
    k, far, coefficients = ERFC[a.format.dtype]
    size = a.clamp(code.call("llvm.fabs", x), None, far)
    square = code.op("fmul", size, size)
    first, *rest = ERF[a.format.dtype]
    near = code.fma(size, a.polynomial(square, (first - 1, *rest)), size)
    t = code.div(code.op("fsub", size, a.real(k)), code.op("fadd", size, a.real(k)))
    tail = code.op("fmul", exp(a, code.op("fneg", square)), a.polynomial(t, coefficients))
    outer = code.op("fsub", a.real(1.0), tail)
    result = code.select(code.compare("olt", size, a.real(1.0)), near, outer)
    return code.call("llvm.copysign", result, x)
