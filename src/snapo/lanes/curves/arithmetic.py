"""The arithmetic that curves are made of."""

import math
from dataclasses import dataclass

from ..emit.code import Code
from ..emit.module import Ref


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
    tiny: float  # x means x + x^2 below
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


class Arithmetic:
    """Arithmetic inside a curve: constants of the right type and width, bits, range reductions."""

    def __init__(self, code: Code, dtype: str, lanes: int):
        self.code, self.lanes = code, lanes
        self.format = FORMATS[dtype]

    def real(self, value: float) -> Ref:
        return self.code.constant(value, self.format.dtype, self.lanes)

    def integer(self, value: int) -> Ref:
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
        """2^(n - less), from n + magic: the shift drops the magic number's bits above n."""
        biased = self.code.add(self.bits(shifted), self.integer(self.format.bias - less))
        return self.value(self.code.op("shl", biased, self.integer(self.format.mantissa)))

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
