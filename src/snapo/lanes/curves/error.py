"""The error function."""

from ..emit.ref import Ref
from .arithmetic import Arithmetic
from .exponentials import exp

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
