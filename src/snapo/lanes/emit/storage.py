"""The place of an array: in registers, element by element (`Small`), or in memory (`ArrayPlace`).

Rearranging a `Small` array rearranges Python objects; rearranging a `ArrayPlace` changes its
strides. Neither costs an instruction.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..program.cut import Leaf
from .code import Code
from .module import Ref


@dataclass(eq=False)
class Small:
    """An array whose elements are registers: a NumPy array of `Ref`."""

    items: Any  # numpy.ndarray of Ref

    @property
    def shape(self) -> tuple[int, ...]:
        return self.items.shape

    @property
    def uniform(self) -> Ref | None:
        """The register that fills the whole array, if there is only one."""
        if not self.items.size:
            return None
        if self.items.size == 1 or not any(
            s for s, n in zip(self.items.strides, self.shape) if n > 1
        ):
            return self.items.flat[0]
        return None


@dataclass(frozen=True, eq=False)
class ArrayPlace:
    """An array in memory: `strides` count elements of `lanes` numbers each."""

    base: str
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype
    lanes: int
    invariant: bool = False

    @property
    def unit(self) -> int:
        """Bytes of one element."""
        return self.lanes * (1 if self.dtype == np.bool_ else self.dtype.itemsize)

    @property
    def contiguous(self) -> bool:
        return self.strides == row_major(self.shape) or math.prod(self.shape) <= 1

    def broadcast(self, shape: tuple[int, ...]) -> "ArrayPlace":
        """This array repeated along axes of length one, as NumPy does."""
        missing = len(shape) - len(self.shape)
        strides = [0] * missing
        for have, want, stride in zip(self.shape, shape[missing:], self.strides):
            strides.append(stride if have == want else 0)
        return replace(self, shape=tuple(shape), strides=tuple(strides))

    def address(self, code: Code, position: Sequence[int | str]) -> str:
        """The pointer to one element; `position` holds numbers and loop counters."""
        fixed = sum(p * s for p, s in zip(position, self.strides) if isinstance(p, int)) * self.unit
        moving = [
            (p, s * self.unit) for p, s in zip(position, self.strides) if isinstance(p, str) and s
        ]
        pointer = self.base
        for counter, stride in moving:
            pointer = code.pointer(pointer, code.index(f"mul nsw i64 {counter}, {stride}"))
        return code.pointer(pointer, self.offset + fixed)

    def at(self, position: Sequence[int]) -> "ArrayPlace":
        """One element, as an array without axes."""
        fixed = sum(p * s for p, s in zip(position, self.strides)) * self.unit
        return replace(self, offset=self.offset + fixed, shape=(), strides=())

    def read(self, code: Code, position: Sequence[int | str]) -> Ref:
        return code.load(self.address(code, position), self.dtype, self.lanes, self.invariant)

    def write(self, code: Code, position: Sequence[int | str], x: Ref) -> None:
        code.store(x, self.address(code, position), self.lanes)


def row_major(shape: tuple[int, ...]) -> tuple[int, ...]:
    strides, step = [], 1
    for size in reversed(shape):
        strides.append(step)
        step *= size
    return tuple(reversed(strides))


class Layout:
    """Offsets of named arrays in one row of bytes, each aligned to a vector register."""

    def __init__(self, lanes: int):
        self.lanes = lanes
        self.size = 0
        self.fields: dict[object, tuple[int, tuple[int, ...], np.dtype]] = {}

    def add(self, key, shape, dtype) -> None:
        dtype = np.dtype(dtype)
        stored = 1 if dtype == np.bool_ else dtype.itemsize
        align = 64 if self.lanes > 1 or math.prod(shape) > 16 else 8
        offset = -(-self.size // align) * align
        self.fields[key] = (offset, tuple(shape), dtype)
        self.size = offset + math.prod(shape) * stored * self.lanes

    def size_to(self, keys: Iterable[object]) -> int:
        """Bytes of a row up to the end of these fields."""
        fields = [self.fields[key] for key in keys]
        sizes = (math.prod(shape) * dtype.itemsize for _, shape, dtype in fields)
        return max((field[0] + self.lanes * size for field, size in zip(fields, sizes)), default=0)

    @property
    def stride(self) -> int:
        """Bytes from one row to the next."""
        return max(64, -(-self.size // 64) * 64)

    def address(self, key, base: str, invariant: bool = False) -> ArrayPlace:
        offset, shape, dtype = self.fields[key]
        return ArrayPlace(base, offset, shape, row_major(shape), dtype, self.lanes, invariant)

    def view(self, memory: np.ndarray, key) -> np.ndarray:
        """A field of all rows, from bytes [..., stride]: [..., *shape] or [..., *shape, lanes]."""
        offset, shape, dtype = self.fields[key]
        lanes = (self.lanes,) if self.lanes > 1 else ()
        size = math.prod(shape) * dtype.itemsize * self.lanes
        field = memory[..., offset : offset + size].view(dtype)
        return field.reshape((*memory.shape[:-1], *shape, *lanes))


@dataclass(frozen=True)
class Shared:
    """Two rows of memory, the call's and the present step's, and the arrays in them by leaf.

    `call_row` and `step_row` are the rows' addresses; outside of a step only the first exists.
    """

    call: Layout
    step: Layout
    call_row: str
    step_row: str | None = None

    def of_call(self, leaf: Leaf) -> bool:
        """Whether an array belongs to the whole call."""
        return leaf in self.call.fields

    def address(self, leaf: Leaf, invariant: bool = False) -> ArrayPlace:
        """The place of an array; `invariant` promises that nothing writes there meanwhile."""
        if self.of_call(leaf):
            return self.call.address(leaf, self.call_row, invariant)
        assert self.step_row is not None
        return self.step.address(leaf, self.step_row, invariant)
