"""Machine code as functions of this process, and the rows of memory that they take."""

import ctypes
import itertools
import threading
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from .pipeline import PIPELINE, binding


class KernelMemory:
    """Named rows of zero bytes on 64-byte boundaries, and their addresses.

    They share one allocation: kernels take addresses, which NumPy is slow to return.
    """

    def __init__(self, sizes: dict[str, int]):
        raw = np.zeros(64 + sum(map(_rounded, sizes.values())), np.uint8)
        self.size = raw.size
        base = address(raw)
        at = -base % 64
        self.rows: dict[str, np.ndarray] = {}
        self.where: dict[str, int] = {}
        for name, size in sizes.items():
            self.rows[name], self.where[name] = raw[at : at + size], base + at
            at += _rounded(size)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.rows[name]

    def lend(self, name: str, array: np.ndarray) -> None:
        """Adds an array that lies elsewhere."""
        self.rows[name], self.where[name] = array, address(array)

    def suffices(self, sizes: dict[str, int]) -> bool:
        """Whether every row has at least its size."""
        return all(self.rows[name].size >= size for name, size in sizes.items())


def _rounded(size: int) -> int:
    return -(-size // 64) * 64


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


class Linked:
    """The functions of one piece of machine code. It keeps the memory of the code alive.

    `entries` are the functions' names, each with the number of its 64-bit integer arguments; all
    functions take an address first, and return nothing.
    """

    def __init__(self, data: bytes, entries: Mapping[str, int]):
        builder = binding().JITLibraryBuilder().add_object_img(data).add_current_process()
        for name in entries:
            builder.export_symbol(name)
        with _linking:
            self._tracker = builder.link(_linker(), f"kernel{next(_numbers)}")
        self.addresses = {name: self._tracker[name] for name in entries}
        self.functions = {
            name: ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_int64] * integers)(
                self.addresses[name]
            )
            for name, integers in entries.items()
        }


_linking = threading.Lock()
_numbers = itertools.count()


@cache
def _linker() -> Any:
    """One linker for the process; libraries in it live as long as their `Linked`."""
    return binding().create_lljit_compiler(PIPELINE.target(), use_jit_link=True)
