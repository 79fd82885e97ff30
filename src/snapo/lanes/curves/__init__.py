"""Curves for vectors of lanes, in float32 and float64: exp, log, log1p, expm1, tanh, erf …

Each is a range reduction and a polynomial, with the special cases selected at the end: correct at
NaN, infinities, denormals and both zeros, and within 2 units in the last place of the exact value,
or 3 for tanh, logistic, erf, pow and atan2, or 6 for tanh in float32, where one ratio takes half
the time (the largest error over all numbers is 5.2 units, that of XLA 4.9; the mean errors are 0.73
and 0.87). Tests measure these errors. Polynomials are near-minimax (Chebyshev interpolation of the
remainder in 40 digits); reductions follow Cody and Waite, "Software Manual for the Elementary
Functions" (1980), and the fdlibm sources. If the result is denormal, exp gives zero, since kernels
treat denormals as zero. Rare functions (`tan`, `asin` …, `pow` in float64) are computed by the C
library, lane by lane.
"""

from collections.abc import Callable

from ..emit.code import Code, Curve
from ..emit.module import Ref
from . import angles, exponentials, logarithms
from .arithmetic import Arithmetic


def _curve(name: str, arguments: int, function: Callable[..., Ref]) -> Curve:
    """A curve from a function of an `Arithmetic` and its arguments."""

    def write(code: Code, *inputs: Ref) -> Ref:
        return function(Arithmetic(code, inputs[0].dtype, inputs[0].lanes), *inputs)

    return Curve(name, arguments, write)


CURVES: dict[str, Curve] = {
    curve.name: curve
    for curve in (
        _curve("exp", 1, exponentials.exp),
        _curve("expm1", 1, exponentials.expm1),
        _curve("log", 1, logarithms.log),
        _curve("log1p", 1, logarithms.log1p),
        _curve("tanh", 1, exponentials.tanh),
        _curve("logistic", 1, exponentials.logistic),
        _curve("erf", 1, exponentials.erf),
        _curve("pow", 2, logarithms.power),
        _curve("sin", 1, angles.sin),
        _curve("cos", 1, angles.cos),
        _curve("atan2", 2, angles.atan2),
    )
}
