"""The position of each array of a program while a function is written."""

import math
from collections.abc import Container
from typing import Any

import numpy as np

from ..program.program import BIG, ProgramValue
from .code import Code
from .module import Ref
from .storage import ArrayPlace, Small, row_major


def fetch(code: Code, source: Ref | ArrayPlace, position, width: int = 1) -> Ref:
    """One element, or `width` neighbours as one long vector of lanes."""
    if isinstance(source, Ref):
        return source if source.lanes == 1 or width == 1 else code.join([source] * width)
    if width == 1:
        return source.read(code, position)
    if source.lanes > 1 and source.dtype != np.bool_:
        return code.load(source.address(code, position), source.dtype, source.lanes * width)
    *front, last = position
    parts = [source.read(code, position)]
    parts += [
        source.read(code, [*front, code.index(f"add nsw i64 {last}, {i}")]) for i in range(1, width)
    ]
    return code.join([code.splat(p, code.lanes) for p in parts])


def put(code: Code, target: ArrayPlace, position, x: Ref, width: int) -> None:
    """Stores one element, or `width` neighbours, as `fetch` reads them."""
    if width == 1:
        target.write(code, position, x)
    else:
        code.store(x, target.address(code, position), target.lanes * width)


class nest:
    """Loops over all positions of `shape`; one loop where every array is stored in order."""

    def __init__(self, code: Code, shape: tuple[int, ...], operands):
        positions = [p for p in operands if isinstance(p, ArrayPlace)]
        self.code, self.shape = code, shape
        self.flat = all(p.contiguous and p.shape == shape for p in positions) and len(shape) > 1
        self.flat = self.flat and all(math.prod(shape) > 1 for _ in positions)
        self.open = []

    def __enter__(self) -> list[int | str]:
        if self.flat:
            loop = self.code.loop(math.prod(self.shape))
            counter = loop.__enter__()
            self.open.append(loop)
            return [0] * (len(self.shape) - 1) + [counter.i]
        position: list[int | str] = []
        for size in self.shape:
            if size == 1:
                position.append(0)
                continue
            loop = self.code.loop(size)
            position.append(loop.__enter__().i)
            self.open.append(loop)
        return position

    def __exit__(self, *error) -> None:
        if error[0] is None:
            for loop in reversed(self.open):
                loop.__exit__(None, None, None)


class Workspace:
    """Scratch memory of one thread, from the address `base` on: arrays between two regions."""

    def __init__(self, base: str):
        self.base = base
        self.size = 0

    def allocate(self, shape, dtype, lanes: int) -> ArrayPlace:
        position = ArrayPlace(
            self.base, self.size, tuple(shape), row_major(tuple(shape)), np.dtype(dtype), lanes
        )
        self.size += -(-math.prod(shape) * position.unit // 64) * 64
        return position


class EmittedValues:
    """The arrays of one program inside one function: in registers, or in memory.

    `homes` are places where certain values must be when the function ends (tape, chunk rows); an
    operation that writes memory writes there at once.
    """

    def __init__(
        self, code: Code, workspace: Workspace, homes: dict[ProgramValue, ArrayPlace] | None = None
    ):
        self.code = code
        self.workspace = workspace
        self.homes = homes or {}
        self.loose: Container[ProgramValue] = ()
        self.finite: set[ProgramValue] = set()  # those known to have no infinity and no NaN
        self._where: dict[ProgramValue, Small | ArrayPlace] = {}

    def bind(self, value: ProgramValue, available: Small | ArrayPlace) -> None:
        """Sets the place of a value from here on."""
        self._where[value] = available

    def held(self, value: ProgramValue) -> Small | ArrayPlace | None:
        """The place of a value; None if it does not exist yet."""
        return self._where.get(value)

    def settle_all(self) -> None:
        """Copies every value to its home."""
        for value in list(self._where):
            self.settle(value)

    def settle(self, value: ProgramValue) -> None:
        """Copies a value to its home if it is not there already."""
        home = self.homes.get(value)
        if home is None or value not in self._where or self._where[value] is home:
            return
        self.copy(value, home)
        if isinstance(self._where[value], ArrayPlace):
            self._where[value] = home

    def lanes(self, value: ProgramValue) -> int:
        return self.code.lanes if value.path else 1

    # Reading.

    def get(self, value: ProgramValue) -> Small | ArrayPlace:
        available = self._where.get(value)
        if available is None:
            assert value.constant is not None, "a value is read before it exists"
            available = self._where[value] = self.constant(value)
        return available

    def constant(self, value: ProgramValue) -> Small | ArrayPlace:
        """A constant: registers if it is small or uniform, else a table in the kernel."""
        array = np.asarray(value.constant)
        if (array.size and np.all(array == array.flat[0])) or array.size == 1:
            ref = self.code.constant(array.flat[0], array.dtype)
            single = np.empty((1,) * array.ndim, object)
            single[...] = ref
            return Small(np.broadcast_to(single, array.shape))
        if array.size <= BIG:
            return Small(
                objects([self.code.constant(x, array.dtype) for x in array.flat], array.shape)
            )
        base = self.code.module.table(array)
        return ArrayPlace(base, 0, array.shape, row_major(array.shape), array.dtype, 1, True)

    def small(self, value: ProgramValue) -> Any:
        """The elements as registers, loaded if they lie in memory."""
        available = self.get(value)
        if isinstance(available, ArrayPlace):
            refs = [
                available.read(self.code, list(map(int, p))) for p in np.ndindex(*available.shape)
            ]
            available = Small(objects(refs, available.shape))
            if value.size <= 4 * BIG:
                self._where[value] = available
        return available.items

    def in_memory(self, value: ProgramValue) -> ArrayPlace:
        """The array in memory, stored there if it lies in registers."""
        available = self.get(value)
        if isinstance(available, ArrayPlace):
            return available
        home = self.homes.get(value)
        if home is None:
            home = self.workspace.allocate(available.shape, value.dtype, self.width(available))
            self.copy(value, home)
        return home

    def width(self, small: Small) -> int:
        return (
            max((r.lanes for r in small.items.flat), default=1)
            if small.uniform is None
            else small.uniform.lanes
        )

    def operand(self, value: ProgramValue, shape: tuple[int, ...]) -> Ref | ArrayPlace:
        """The source for a loop over `shape`: one register for all elements, or memory."""
        available = self.get(value)
        if isinstance(available, Small) and available.uniform is not None:
            return available.uniform
        return self.in_memory(value).broadcast(shape)

    # Writing.

    def set(self, value: ProgramValue, items: np.ndarray | Ref) -> None:
        """Registers for a value; NumPy gives a bare element if an array has no axes."""
        if isinstance(items, Ref):
            items = objects([items], ())
        self._where[value] = Small(items)

    def target(self, value: ProgramValue) -> ArrayPlace:
        """Memory for a new array: its home, or the workspace."""
        home = self.homes.get(value)
        return home or self.workspace.allocate(value.shape, value.dtype, self.lanes(value))

    def copy(self, value: ProgramValue, target: ArrayPlace) -> None:
        """Writes a value to a place; the value also stays where it was."""
        available = self.get(value)
        if (isinstance(available, Small) and available.uniform is None) or math.prod(
            available.shape
        ) <= BIG:
            for p in np.ndindex(*target.shape):
                ref = (
                    available.items[p]
                    if isinstance(available, Small)
                    else available.read(self.code, list(map(int, p)))
                )
                target.write(self.code, list(map(int, p)), ref)
            return
        source = self.operand(value, value.shape)
        with nest(self.code, value.shape, [source, target]) as position:
            target.write(self.code, position, fetch(self.code, source, position))


def objects(refs: list[Ref], shape) -> np.ndarray:
    """Registers as an array: NumPy must not look inside them."""
    array = np.empty(len(refs), object)
    for i, ref in enumerate(refs):
        array[i] = ref
    return array.reshape(shape)
