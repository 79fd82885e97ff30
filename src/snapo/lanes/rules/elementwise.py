"""Elementwise primitives: from JAX's name and typed operands to vector instructions."""

from collections.abc import Callable

import numpy as np

from .. import Unsupported
from ..curves import CURVES
from ..emit.code import Code
from ..emit.module import Ref
from ..program.cut import BARRIER
from ..program.program import Op, name_of
from .conversions import FLOAT, compare, convert, one_like, width, zero_like

LIBRARY = {
    "tan": "llvm.tan", "asin": "llvm.asin", "acos": "llvm.acos",
    "atan": "llvm.atan", "sinh": "llvm.sinh", "cosh": "llvm.cosh", "exp2": "llvm.exp2",
    "log2": "llvm.log2",
    "sqrt": "llvm.sqrt", "floor": "llvm.floor", "ceil": "llvm.ceil",
}  # fmt: skip
C_LIBRARY = {
    "cbrt": "cbrt", "asinh": "asinh", "acosh": "acosh", "atanh": "atanh", "erfc": "erfc",
    "lgamma": "lgamma",
}  # fmt: skip
BITS = {"and": "and", "or": "or", "xor": "xor", "shift_left": "shl"}
SHIFTS = {"shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}


def apply(code: Code, op: Op, inputs: list[Ref]) -> Ref:
    """One operation on one element."""
    name, dtype = op.name, name_of(op.outputs[0].dtype)
    if name in FLOAT:
        return compare(code, name, *inputs)
    if name in CURVES:
        return code.apply(CURVES[name], *(convert(code, x, inputs[0].dtype) for x in inputs))
    if name in LIBRARY:
        return code.call(LIBRARY[name], *inputs)
    if name in BITS:
        return code.op(BITS[name], *inputs)
    if name in SHIFTS:
        return _shift(code, SHIFTS[name], *inputs)
    if name == "convert_element_type":
        return convert(code, inputs[0], dtype)
    if name == "bitcast_convert_type":
        return _same_bits(code, op, inputs[0])
    if name == "integer_pow":
        return _power(code, inputs[0], op.params["y"])
    if name == "fma":
        return _multiply_add(code, op, *inputs)
    if name == "reduce_precision":
        return _reduced(op, inputs[0])
    if name in C_LIBRARY:
        return lanewise(code, C_LIBRARY[name], inputs[0])
    if name == "round":
        ties_even = int(op.params["rounding_method"]) == 1
        return code.call("llvm.roundeven" if ties_even else "llvm.round", *inputs)
    rule = RULES.get(name)
    if rule is None:
        raise Unsupported(f"{name}, at {op.where}")
    return rule(code, *inputs)


def supported(name: str) -> bool:
    """Whether a primitive is elementwise and known."""
    available = (FLOAT, CURVES, LIBRARY, C_LIBRARY, BITS, SHIFTS, RULES)
    others = (
        "fma", "convert_element_type", "bitcast_convert_type", "integer_pow", "round",
        "reduce_precision",
    )  # fmt: skip
    return any(name in k for k in available) or name in others


def lanewise(code: Code, function: str, x: Ref) -> Ref:
    """A function of the C library, lane by lane."""
    kind = "float" if x.dtype == "float32" else "double"
    name = f"@{function}{'f' if x.dtype == 'float32' else ''}"
    code.module.declare(f"declare {kind} {name}({kind})")
    result = "poison"
    for i in range(x.lanes):
        lane = code.raw(f"extractelement {x.type} {x.text}, i64 {i}")
        value = code.raw(f"call {kind} {name}({kind} {lane})")
        result = code.raw(f"insertelement {x.type} {result}, {kind} {value}, i64 {i}")
    return Ref(result, x.dtype, x.lanes)


def _multiply_add(code: Code, op: Op, x: Ref, y: Ref, z: Ref) -> Ref:
    """x y + z, rounded once, with the signs of `fuse`."""
    x = _negate(code, x) if op.params["minus_product"] else x
    z = _negate(code, z) if op.params["minus_other"] else z
    return code.fma(*code.same(x, y, z))


def _reduced(op: Op, x: Ref) -> Ref:
    """Rounding to the digits that the type has anyway."""
    selected = (op.params["exponent_bits"], op.params["mantissa_bits"])
    if selected != ((8, 23) if x.dtype == "float32" else (11, 52)):
        raise Unsupported(f"reduce_precision: to {selected} bits, at {op.where}")
    return x


def _same_bits(code: Code, op: Op, x: Ref) -> Ref:
    """The bits of a number as a number of another type, as wide."""
    dtype = op.outputs[0].dtype
    if dtype.itemsize != op.inputs[0].dtype.itemsize:
        raise Unsupported(f"bitcast_convert_type: to {dtype}, of another width, at {op.where}")
    return code.convert("bitcast", x, dtype.name)


def _extreme(code: Code, a: Ref, b: Ref, larger: bool) -> Ref:
    """max or min; a NaN on either side is the answer."""
    if not a.floating:
        if a.dtype == "bool":
            return code.op("or" if larger else "and", a, b)
        kind = ("u" if a.unsigned else "s") + ("max" if larger else "min")
        return code.call(f"llvm.{kind}", a, b)
    if a.value is None and b.value is not None:
        a, b = b, a
    selected = code.select(
        code.compare("ogt" if larger else "olt", a, b), a, b
    )  # b where one is NaN
    if a.value is not None:
        return selected
    return code.select(code.compare("uno", a, a), a, selected)


def _divide(code: Code, a: Ref, b: Ref) -> Ref:
    """Integer division by zero gives -1 (all bits), as in XLA, and does not trap."""
    if a.floating:
        return code.div(a, b)
    zero, one = zero_like(code, b), one_like(code, b)
    empty = compare(code, "eq", b, zero)
    if a.unsigned:
        quotient = code.op("udiv", a, code.select(empty, one, b))
        return code.select(empty, code.constant(np.iinfo(a.dtype).max, a.dtype, a.lanes), quotient)
    minus = code.constant(-1, b.dtype, b.lanes)
    flip = compare(code, "eq", b, minus)
    safe = code.select(code.op("or", empty, flip), one, b)
    quotient = code.op("sdiv", a, safe)
    quotient = code.select(flip, code.sub(zero_like(code, a), a), quotient)
    return code.select(empty, code.constant(-1, a.dtype, a.lanes), quotient)


def _remainder(code: Code, a: Ref, b: Ref) -> Ref:
    if a.floating:
        return code.op("frem", a, b)
    return code.sub(a, code.mul(_divide_or_zero(code, a, b), b))


def _divide_or_zero(code: Code, a: Ref, b: Ref) -> Ref:
    """The remainder of a division by zero is the dividend."""
    zero = zero_like(code, b)
    return code.select(compare(code, "eq", b, zero), zero, _divide(code, a, b))


def _power(code: Code, x: Ref, exponent: int) -> Ref:
    """x^n by squaring, in XLA's order; a negative power is the reciprocal of the positive."""
    if exponent == 0:
        return code.constant(1, x.dtype, x.lanes)
    n, result, square = abs(exponent), None, x
    while n:
        if n & 1:
            result = square if result is None else code.mul(result, square)
        n >>= 1
        if n:
            square = code.mul(square, square)
    assert result is not None
    return result if exponent > 0 else code.div(code.constant(1, x.dtype, x.lanes), result)


def _sign(code: Code, x: Ref) -> Ref:
    zero, one = zero_like(code, x), one_like(code, x)
    if x.unsigned:
        return code.select(compare(code, "ne", x, zero), one, zero)
    minus = code.constant(-1, x.dtype, x.lanes)
    result = code.select(compare(code, "gt", x, zero), one, x if x.floating else zero)
    return code.select(compare(code, "lt", x, zero), minus, result)


def _absolute(code: Code, x: Ref) -> Ref:
    if x.floating:
        return code.call("llvm.fabs", x)
    if x.unsigned:
        return x
    return code.select(
        compare(code, "lt", x, zero_like(code, x)), code.sub(zero_like(code, x), x), x
    )


def _negate(code: Code, x: Ref) -> Ref:
    return code.op("fneg", x) if x.floating else code.sub(zero_like(code, x), x)


def _invert(code: Code, x: Ref) -> Ref:
    ones = True if x.dtype == "bool" else (-1 if not x.unsigned else np.iinfo(x.dtype).max)
    return code.op("xor", x, code.constant(ones, x.dtype, x.lanes))


def select(code: Code, which: Ref, *options: Ref) -> Ref:
    """`select_n`, by a mask or by an integer."""
    if which.dtype == "bool":
        return code.select(which, options[1], options[0])
    result = options[0]
    for i, option in enumerate(options[1:], 1):
        result = code.select(
            compare(code, "ge", which, code.constant(i, which.dtype)), option, result
        )
    return result


def _add_any(code: Code, a: Ref, b: Ref) -> Ref:
    """A sum of cotangents: a known zero adds nothing."""
    if a.value is not None and a.value == 0:
        return b
    if b.value is not None and b.value == 0:
        return a
    return code.add(a, b)


def _finite(code: Code, x: Ref) -> Ref:
    size = code.call("llvm.fabs", x)
    return code.compare("olt", size, code.constant(np.inf, x.dtype, x.lanes))


def _clamp(code: Code, low: Ref, x: Ref, high: Ref) -> Ref:
    return _extreme(code, _extreme(code, x, low, True), high, False)


def _shift(code: Code, instruction: str, x: Ref, by: Ref) -> Ref:
    bits = code.constant(width(x.dtype), x.dtype, x.lanes)
    inside = compare(code, "lt", Ref(by.text, "u" + x.dtype.lstrip("u"), by.lanes, by.value), bits)
    shifted = code.op(instruction, x, code.select(inside, by, zero_like(code, by)))
    return code.select(inside, shifted, zero_like(code, x))


def _total_order(strict: bool) -> Callable:
    """Comparison in which NaN is above everything, as sorting uses it."""

    def rule(code: Code, a: Ref, b: Ref) -> Ref:
        if not a.floating:
            return compare(code, "lt" if strict else "le", a, b)
        below = code.compare("olt" if strict else "ole", a, b)
        odd_a, odd_b = code.compare("uno", a, a), code.compare("uno", b, b)
        if strict:
            true = code.constant(True, "bool", odd_a.lanes)
            return code.op("or", below, code.op("and", odd_b, code.op("xor", odd_a, true)))
        return code.op("or", below, odd_b)

    return rule


def _rsqrt(code: Code, x: Ref) -> Ref:
    return code.div(one_like(code, x), code.call("llvm.sqrt", x))


def _one_minus_square(code: Code, x: Ref) -> Ref:
    """1 - x^2 without cancellation near one, as JAX writes it: the derivative of tanh."""
    one = one_like(code, x)
    return code.mul(code.add(one, x), code.sub(one, x))


def _polynomial(code: Code, x: Ref, *coefficients: Ref) -> Ref:
    """c0 + c1 x + c2 x^2 …, by Horner's rule."""
    *others, result = coefficients
    for coefficient in reversed(others):
        result = code.add(code.mul(result, x), coefficient)
    return result


RULES: dict[str, Callable[..., Ref]] = {
    "add": Code.add,
    "sub": Code.sub,
    "mul": Code.mul,
    "add_any": _add_any,
    "div": _divide,
    "rem": _remainder,
    "neg": _negate,
    "abs": _absolute,
    "sign": _sign,
    BARRIER: lambda code, x: x,
    "not": _invert,
    "max": lambda code, a, b: _extreme(code, a, b, True),
    "min": lambda code, a, b: _extreme(code, a, b, False),
    "clamp": _clamp,
    "select_n": select,
    "is_finite": _finite,
    "square": lambda code, x: code.mul(x, x),
    "one_minus_square": _one_minus_square,
    "polynomial": _polynomial,
    "rsqrt": _rsqrt,
    "lt_to": _total_order(True),
    "le_to": _total_order(False),
}
