"""Straight-line programs: operations on typed arrays, the types of numbers, and constants."""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

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
    """NumPy's name of a type; NumPy builds it at each access."""
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


BIG = 12  # arrays of more numbers than this live in memory, smaller ones in registers


@dataclass(eq=False)
class ProgramValue:
    """One array of a program: `path`: whether it differs between paths.

    If the content of a value is known at compile time, `constant` has it.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    path: bool = False
    constant: np.ndarray | None = None

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def floating(self) -> bool:
        return self.dtype.kind == "f"


@dataclass(eq=False)
class Op:
    """One operation: a JAX primitive's name with its parameters, and where the user wrote it."""

    name: str
    inputs: list[ProgramValue]
    outputs: list[ProgramValue]
    params: dict[str, Any] = field(default_factory=dict)
    where: str = ""


@dataclass(eq=False)
class Program:
    """Inputs, operations in order, outputs."""

    inputs: list[ProgramValue]
    ops: list[Op]
    outputs: list[ProgramValue]


def constant(array) -> ProgramValue:
    """A value that is constant at compile time."""
    array = np.asarray(array)
    return ProgramValue(array.shape, array.dtype, False, array)


def walk(program: Program) -> Iterator[str]:
    """The program as text, for `explain` and for tests."""
    names: dict[ProgramValue, str] = {}

    def name(value: ProgramValue) -> str:
        if value.constant is not None:
            text = str(value.constant) if value.size == 1 else f"constant{list(value.shape)}"
            return text
        if value not in names:
            names[value] = f"{'v' if value.path else 's'}{len(names)}"
        shape = ",".join(map(str, value.shape))
        return f"{names[value]}:{value.dtype.name}[{shape}]"

    yield "inputs  " + "  ".join(name(v) for v in program.inputs)
    for op in program.ops:
        outputs = "  ".join(name(v) for v in op.outputs)
        yield f"  {outputs} = {op.name} {' '.join(name(v).split(':')[0] for v in op.inputs)}"
    yield "outputs " + "  ".join(name(v).split(":")[0] for v in program.outputs)
