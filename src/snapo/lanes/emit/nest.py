"""Loops over the elements of arrays, and the reading and writing inside them."""

import math

import numpy as np

from .code import Code
from .ref import Ref
from .storage import ArrayPlace


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
