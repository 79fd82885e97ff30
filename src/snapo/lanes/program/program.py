"""Straight-line programs: typed values, operations on them, and their text."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

BIG = 12  # arrays of more numbers than this live in memory, smaller ones in registers


@dataclass(eq=False)
class ProgramValue:
    """One array of a program: `path` says whether it differs between paths.

    A value whose content is known while compiling carries it in `constant`.
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
    """A value known while compiling."""
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
