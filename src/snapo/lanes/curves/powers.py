"""x^y."""

import math

from ..emit.ref import Ref
from .arithmetic import Arithmetic
from .exponentials import exp
from .logarithms import log


def power(a: Arithmetic, x: Ref, y: Ref) -> Ref:
    """x^y by float64 logarithms for float32; float64 goes to the C library."""
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
