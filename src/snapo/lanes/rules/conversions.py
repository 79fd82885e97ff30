"""Comparisons of numbers, and conversions between types as XLA does them."""

import numpy as np

from ..emit.code import Code
from ..emit.module import Ref

FLOAT = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}
SIGNED = {"lt": "slt", "le": "sle", "gt": "sgt", "ge": "sge", "eq": "eq", "ne": "ne"}
UNSIGNED = {"lt": "ult", "le": "ule", "gt": "ugt", "ge": "uge", "eq": "eq", "ne": "ne"}


def compare(code: Code, name: str, a: Ref, b: Ref) -> Ref:
    table = FLOAT if a.floating else UNSIGNED if a.unsigned else SIGNED
    return code.compare(table[name], a, b)


def convert(code: Code, x: Ref, dtype: str) -> Ref:
    """Converts between types as XLA does: rounds towards zero and saturates; NaN becomes 0."""
    if x.dtype == dtype:
        return x
    if x.value is not None:
        return code.constant(np.asarray(x.value).astype(dtype), dtype, x.lanes)
    if dtype == "bool":
        return compare(code, "ne", x, code.constant(0, x.dtype, x.lanes))
    if x.floating and dtype.startswith("float"):
        return code.convert("fpext" if dtype == "float64" else "fptrunc", x, dtype)
    if x.floating and dtype == "int32":
        return _whole(code, x)
    if x.floating:
        function = "llvm.fptoui.sat" if dtype.startswith("uint") else "llvm.fptosi.sat"
        return _saturate(code, function, x, dtype)
    if x.dtype == "bool" and dtype.startswith("float"):
        # Not `uitofp`: LLVM turns a product with that into a selection, which loses 0 * NaN.
        return code.select(x, code.constant(1, dtype, x.lanes), code.constant(0, dtype, x.lanes))
    if dtype.startswith("float"):
        return code.convert("uitofp" if x.unsigned else "sitofp", x, dtype)
    before, after = width(x.dtype), width(dtype)
    if before == after:
        return Ref(x.text, dtype, x.lanes)
    if before > after:
        return code.convert("trunc", x, dtype)
    return code.convert("zext" if x.unsigned else "sext", x, dtype)


def width(dtype: str) -> int:
    """Bits of a number."""
    return 1 if dtype == "bool" else 8 * np.dtype(dtype).itemsize


def _whole(code: Code, x: Ref) -> Ref:
    """Towards zero into 32 bits: saturating instructions are made lane by lane on x86."""
    low, high = np.iinfo(np.int32).min, np.iinfo(np.int32).max
    largest = np.nextafter(np.float32(2**31), np.float32(0)) if x.dtype == "float32" else high
    available = code.select(code.compare("ord", x, x), x, zero_like(code, x))
    top, bottom = (code.constant(v, x.dtype, x.lanes) for v in (largest, low))
    within = code.select(code.compare("ogt", available, top), top, available)
    within = code.select(code.compare("olt", within, bottom), bottom, within)
    result = code.convert("fptosi", within, "int32")
    if x.dtype == "float64":
        return result
    return code.select(code.compare("ogt", available, top), code.constant(high, "int32"), result)


def _saturate(code: Code, function: str, x: Ref, dtype: str) -> Ref:
    result = Ref("", dtype, x.lanes)
    kind = "f32" if x.dtype == "float32" else "f64"
    name = f"@{function}.v{x.lanes}i{width(dtype)}.v{x.lanes}{kind}"
    code.module.declare(f"declare {result.type} {name}({x.type})")
    return Ref(code.raw(f"call {result.type} {name}({x.type} {x.text})"), dtype, x.lanes)


def zero_like(code: Code, x: Ref) -> Ref:
    return code.constant(0, x.dtype, x.lanes)


def one_like(code: Code, x: Ref) -> Ref:
    return code.constant(1, x.dtype, x.lanes)
