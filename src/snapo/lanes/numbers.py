"""Types of numbers: NumPy's names and LLVM's, and constants as text."""

import struct
from functools import cache

import numpy as np

TYPES = {
    "float32": "float", "float64": "double", "int8": "i8", "int16": "i16", "int32": "i32",
    "int64": "i64", "uint8": "i8", "uint16": "i16", "uint32": "i32", "uint64": "i64", "bool": "i1",
}  # fmt: skip


def supported(dtype) -> bool:
    """Whether numbers of this type can be compiled."""
    return getattr(dtype, "name", str(dtype)) in TYPES


@cache
def name_of(dtype) -> str:
    """NumPy's name of a type; NumPy puts it together anew each time."""
    return np.dtype(dtype).name


def stored(dtype: str) -> str:
    """The type that a number has in memory: booleans are bytes there."""
    return "int8" if dtype == "bool" else dtype


def number(value, dtype: str) -> str:
    """A scalar constant as LLVM writes it."""
    if dtype.startswith("float"):
        exact = float(np.dtype(dtype).type(value))
        return f"0x{struct.unpack('<Q', struct.pack('<d', exact))[0]:016X}"
    if dtype == "bool":
        return "true" if value else "false"
    return str(int(value))


def suffix(dtype: str) -> str:
    """The type in the name of an intrinsic: f32, f64, i32 …"""
    name = TYPES[dtype]
    return {"float": "f32", "double": "f64"}.get(name, name)
