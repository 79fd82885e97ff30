"""Curves for vectors of lanes, in float32 and float64: exp, log, log1p, expm1, tanh, erf …

Each is a range reduction and a polynomial, with the special cases selected at the end: right at
NaN, infinities, denormals and both zeros, and within 2 units in the last place of the exact value,
or 3 for tanh, logistic, erf, pow and atan2, or 6 for tanh in float32, where one ratio takes half
the time (of all numbers the worst is 5.2 off, XLA's own 4.9; on average 0.73 and 0.87). The tests
measure it. Polynomials are near-minimax (Chebyshev interpolation of the remainder in 40 digits);
reductions follow Cody and Waite, "Software Manual for the Elementary Functions" (1980), and the
fdlibm sources. Where the answer is denormal exp gives zero, which kernels would make of it anyway.
What is rare (`tan`, `asin` …, `pow` in float64) goes to the C library lane by lane.
"""

import math
from dataclasses import dataclass

from .code import Code, Module, Ref


@dataclass(frozen=True)
class Format:
    """A floating type: the integers that its bits are read as, and its reductions."""

    dtype: str
    integer: str
    mantissa: int
    bias: int
    magic: float  # adding it rounds to an integer and leaves that integer in the low bits
    ln2_high: float
    ln2_low: float
    largest: float  # the last x whose exp is finite
    smallest: float  # the first whose exp is not denormal
    tiny: float  # x stands for x + x^2 below
    normal: float  # the smallest normal number
    half_root: int  # the bits of sqrt(1/2)


FORMATS = {
    "float32": Format(
        "float32", "int32", 23, 127, 1.5 * 2**23, 0.693359375, -2.12194440e-4,
        88.72283172607422, -87.33654022216797, 2.0**-26, 2.0**-126, 0x3F3504F3,
    ),
    "float64": Format(
        "float64", "int64", 52, 1023, 1.5 * 2**52, 6.93147180369123816490e-01,
        1.90821492927058770002e-10, 709.782712893384, -708.3964185322641,
        2.0**-55, 2.0**-1022, 0x3FE6A09E667F3BCD,
    ),
}  # fmt: skip

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
# tanh(x) / x as a ratio of polynomials in x^2 up to the x from which the nearest number is 1:
# minimax (2e-8), then the neighbours in float32 that round best.
TANH32 = 9.02, (
    1.0, 0.13382688164710999, 0.003497461322695017, 2.0635883629438467e-05, 1.3384359398571632e-08,
), (
    1.0, 0.46716001629829407, 0.02588437683880329, 0.0003288522711955011, 7.79027971020696e-07,
)  # fmt: skip
# tanh(y) / y in y^2 for |y| < ln 2 / 4: the sixth convergent of its continued fraction.
TANH64 = (10395.0, 1260.0, 21.0), (10395.0, 4725.0, 210.0, 1.0)
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


class Curve:
    """The body of one function under construction: arithmetic with constants of the right type."""

    def __init__(self, code: Code, dtype: str, lanes: int):
        self.code, self.lanes = code, lanes
        self.format = FORMATS[dtype]

    def real(self, value: float) -> Ref:
        return self.code.constant(value, self.format.dtype, self.lanes)

    def whole(self, value: int) -> Ref:
        return self.code.constant(value, self.format.integer, self.lanes)

    def polynomial(self, x: Ref, coefficients) -> Ref:
        """Horner's rule on fused multiply-adds."""
        result = self.real(coefficients[-1])
        for c in coefficients[-2::-1]:
            result = self.code.fma(result, x, self.real(c))
        return result

    def bits(self, x: Ref) -> Ref:
        return self.code.convert("bitcast", x, self.format.integer)

    def value(self, bits: Ref) -> Ref:
        return self.code.convert("bitcast", bits, self.format.dtype)

    def power_of_two(self, shifted: Ref, less: int = 0) -> Ref:
        """2^(n - less), from n + magic: the shift drops what the magic number put above n."""
        biased = self.code.add(self.bits(shifted), self.whole(self.format.bias - less))
        return self.value(self.code.op("shl", biased, self.whole(self.format.mantissa)))

    def clamp(self, x: Ref, low: float | None, high: float | None) -> Ref:
        """x within bounds; NaN stays NaN."""
        if high is not None:
            x = self.code.select(self.code.compare("ogt", x, self.real(high)), self.real(high), x)
        if low is not None:
            x = self.code.select(self.code.compare("olt", x, self.real(low)), self.real(low), x)
        return x

    def octaves(self, x: Ref, width: float = 1.0) -> tuple[Ref, Ref]:
        """x = n w + r with w = `width` ln 2 and |r| <= w / 2: n (plus the magic number), and r."""
        code, f = self.code, self.format
        shifted = code.fma(x, self.real(1 / (width * math.log(2))), self.real(f.magic))
        n = code.op("fsub", shifted, self.real(f.magic))
        r = code.fma(n, self.real(-width * f.ln2_high), x)
        return shifted, code.fma(n, self.real(-width * f.ln2_low), r)

    def growth(self, r: Ref) -> Ref:
        """exp(r) - 1 for small r."""
        return self.code.fma(self.code.mul(r, r), self.polynomial(r, EXP[self.format.dtype]), r)

    def exp(self, x: Ref) -> Ref:
        """1 + growth, with n added to its exponent; what would be denormal is zero."""
        code, f = self.code, self.format
        if f.dtype == "float32":
            shifted, r = self.octaves(x)
            growth = self.growth(r)
        else:
            # Twice p / (q - p), with p / q the tangent of half of what remains.
            shifted, y = self.octaves(code.op("fmul", x, self.real(0.5)), 0.5)
            p, q = self.tangent(y)
            growth = code.div(code.op("fadd", p, p), code.op("fsub", q, p))
        near_one = self.bits(code.op("fadd", growth, self.real(1.0)))
        octaves = code.op("shl", self.bits(shifted), self.whole(f.mantissa))
        result = self.value(code.add(near_one, octaves))
        beyond = code.op("fadd", x, self.real(math.inf))  # NaN for NaN
        result = code.select(code.compare("ugt", x, self.real(f.largest)), beyond, result)
        return code.select(code.compare("olt", x, self.real(f.smallest)), self.real(0.0), result)

    def tangent(self, y: Ref) -> tuple[Ref, Ref]:
        """p and q with p / q = tanh(y), for |y| < ln 2 / 4 in float64."""
        square = self.code.op("fmul", y, y)
        p = self.code.op("fmul", y, self.polynomial(square, TANH64[0]))
        return p, self.polynomial(square, TANH64[1])

    def expm1(self, x: Ref) -> Ref:
        """2^n (exp(r) - 1) + 2^n - 1, at half size so that 2^n does not overflow."""
        code, f = self.code, self.format
        shifted, r = self.octaves(self.clamp(x, -f.mantissa - 10.0, math.ceil(f.largest)))
        p = self.growth(r)
        scale = self.power_of_two(shifted, 1)
        whole = code.fma(scale, p, code.op("fsub", scale, self.real(0.5)))
        whole = code.op("fadd", whole, whole)
        result = code.select(code.compare("oeq", shifted, self.real(f.magic)), p, whole)
        return code.call("llvm.copysign", result, x)

    def tanh(self, x: Ref) -> Ref:
        """A ratio of polynomials: in float32 of x itself, in float64 of what halves of ln 2 leave.

        With |x| = n ln 2 / 2 + y and tanh(y) = p / q the answer is
        ((2^n - 1) q + (2^n + 1) p) / ((2^n + 1) q + (2^n - 1) p).
        """
        code, f = self.code, self.format
        if f.dtype == "float32":
            end, top, bottom = TANH32
            x = self.clamp(x, -end, end)
            square = code.op("fmul", x, x)
            top = code.op("fmul", x, self.polynomial(square, top))
            return self.clamp(code.div(top, self.polynomial(square, bottom)), -1.0, 1.0)
        size = self.clamp(code.call("llvm.fabs", x), None, 20.0)  # where the answer is 1
        shifted, y = self.octaves(size, 0.5)
        scale, (p, q) = self.power_of_two(shifted), self.tangent(y)
        less, more = (code.op(o, scale, self.real(1.0)) for o in ("fsub", "fadd"))
        top = code.fma(less, q, code.op("fmul", more, p))
        bottom = code.fma(more, q, code.op("fmul", less, p))
        return code.call("llvm.copysign", code.div(top, bottom), x)

    def logistic(self, x: Ref) -> Ref:
        """1 / (1 + exp(-x)), from exp(-|x|) so that the small tail keeps its digits."""
        code = self.code
        e = self.exp(code.op("fneg", code.call("llvm.fabs", x)))
        top = code.select(code.compare("olt", x, self.real(0.0)), e, self.real(1.0))
        return code.div(top, code.op("fadd", e, self.real(1.0)))

    def split(self, x: Ref) -> tuple[Ref, Ref]:
        """x = 2^e (1 + f) with 1 + f between sqrt(1/2) and sqrt(2): e as a number, and f."""
        code, f = self.code, self.format
        one = 0x3F800000 if f.dtype == "float32" else 0x3FF0000000000000
        shifted = code.add(self.bits(x), self.whole(one - f.half_root))
        e = code.sub(code.op("ashr", shifted, self.whole(f.mantissa)), self.whole(f.bias))
        mantissa = code.op("and", shifted, self.whole((1 << f.mantissa) - 1))
        m = self.value(code.add(mantissa, self.whole(f.half_root)))
        if f.integer == "int64":
            e = code.convert("trunc", e, "int32")
        return code.convert("sitofp", e, f.dtype), code.op("fsub", m, self.real(1.0))

    def logarithm(self, e: Ref, f: Ref, extra: Ref | None = None) -> Ref:
        """e ln 2 + log(1 + f) + extra, for a small `extra`."""
        code = self.code
        half = code.op("fmul", code.op("fmul", f, f), self.real(0.5))
        if self.format.dtype == "float32":
            cube = code.op("fmul", code.op("fmul", f, f), f)
            small = code.op("fmul", cube, self.polynomial(f, LOG32))
        else:
            s = code.div(f, code.op("fadd", f, self.real(2.0)))
            z = code.op("fmul", s, s)
            tail = code.op("fmul", z, self.polynomial(z, LOG64))
            small = code.op("fmul", s, code.op("fadd", half, tail))
        small = code.fma(e, self.real(self.format.ln2_low), small)
        if extra is not None:
            small = code.op("fadd", small, extra)
        small = code.op("fsub", small, half)
        return code.fma(e, self.real(self.format.ln2_high), code.op("fadd", f, small))

    def log(self, x: Ref) -> Ref:
        code, f = self.code, self.format
        denormal = code.compare("olt", x, self.real(f.normal))
        up = f.mantissa + 2
        e, rest = self.split(code.select(denormal, code.op("fmul", x, self.real(2.0**up)), x))
        shift = code.select(denormal, self.real(-float(up)), self.real(0.0))
        return self._domain(x, 0.0, self.logarithm(code.op("fadd", e, shift), rest))

    def log1p(self, x: Ref) -> Ref:
        """log(u) + (1 + x - u) / u with u = 1 + x rounded."""
        code = self.code
        one = self.real(1.0)
        u = code.op("fadd", x, one)
        above = code.compare("oge", x, one)
        lost = code.select(
            above,
            code.op("fsub", one, code.op("fsub", u, x)),
            code.op("fsub", x, code.op("fsub", u, one)),
        )
        e, f = self.split(u)
        result = self.logarithm(e, f, code.div(lost, u))
        small = code.compare("olt", code.call("llvm.fabs", x), self.real(self.format.tiny))
        return code.select(small, x, self._domain(x, -1.0, result))

    def _domain(self, x: Ref, pole: float, result: Ref) -> Ref:
        """Minus infinity at the pole, NaN below it, infinity at infinity."""
        code = self.code
        inside = code.compare("ogt", x, self.real(pole))
        at_pole = code.compare("oeq", x, self.real(pole))
        outside = code.select(at_pole, self.real(-math.inf), self.real(math.nan))
        infinite = code.compare("oeq", x, self.real(math.inf))
        return code.select(infinite, x, code.select(inside, result, outside))

    def erf(self, x: Ref) -> Ref:
        code = self.code
        k, far, coefficients = ERFC[self.format.dtype]
        size = self.clamp(code.call("llvm.fabs", x), None, far)
        square = code.op("fmul", size, size)
        first, *rest = ERF[self.format.dtype]
        near = code.fma(size, self.polynomial(square, (first - 1, *rest)), size)
        t = code.div(code.op("fsub", size, self.real(k)), code.op("fadd", size, self.real(k)))
        tail = code.op("fmul", self.exp(code.op("fneg", square)), self.polynomial(t, coefficients))
        outer = code.op("fsub", self.real(1.0), tail)
        result = code.select(code.compare("olt", size, self.real(1.0)), near, outer)
        return code.call("llvm.copysign", result, x)

    def pow(self, x: Ref, y: Ref) -> Ref:
        """x^y by float64 logarithms for float32; float64 goes to the C library."""
        code = self.code
        if self.format.dtype == "float64":
            return code.call("llvm.pow", x, y)
        size = code.call("llvm.fabs", x)
        wide = Curve(code, "float64", self.lanes)
        exponent = code.op(
            "fmul",
            code.convert("fpext", y, "float64"),
            wide.log(code.convert("fpext", size, "float64")),
        )
        result = code.convert("fptrunc", wide.exp(exponent), "float32")
        half = code.op("fmul", y, self.real(0.5))
        whole = code.compare("oeq", code.call("llvm.trunc", y), y)
        odd = code.op("and", whole, code.compare("une", code.call("llvm.trunc", half), half))
        signed = code.call("llvm.copysign", result, x)
        result = code.select(odd, signed, result)
        negative = code.compare("olt", x, self.real(0.0))
        negative = code.op("and", negative, code.compare("ogt", x, self.real(-math.inf)))
        finite = code.compare("olt", code.call("llvm.fabs", y), self.real(math.inf))
        broken = code.op(
            "and",
            negative,
            code.op("and", finite, code.compare("une", code.call("llvm.trunc", y), y)),
        )
        result = code.select(broken, self.real(math.nan), result)
        unit = code.compare("oeq", size, self.real(1.0))
        infinite = code.compare("oeq", code.call("llvm.fabs", y), self.real(math.inf))
        positive = code.compare("ogt", x, self.real(0.0))
        sure = code.op("and", unit, code.op("or", positive, infinite))
        one = code.op("or", code.compare("oeq", y, self.real(0.0)), sure)
        return code.select(one, self.real(1.0), result)


CURVES = {
    "exp": 1, "expm1": 1, "log": 1, "log1p": 1, "tanh": 1, "logistic": 1, "erf": 1, "pow": 2,
    "sin": 1, "cos": 1, "atan2": 2,
}  # fmt: skip


def define(full: str, name: str, dtype: str, lanes: int, module: Module) -> str:
    """The text of one function for one type and width."""
    from .angles import Angles

    code = Code(lanes, module)
    inputs = [Ref(f"%x{i}", dtype, lanes) for i in range(CURVES[name])]
    result = getattr(Angles(code, dtype, lanes), name)(*inputs)
    arguments = ", ".join(f"{r.type} {r.text}" for r in inputs)
    code.do(f"ret {result.type} {result.text}")
    body = "\n".join(code.lines)
    header = f"define internal {result.type} @{full}({arguments}) alwaysinline nounwind #0"
    return f"{header} {{\nentry:\n{body}\n}}"
