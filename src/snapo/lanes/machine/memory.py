"""Memory for kernels: rows on 64-byte boundaries, and their addresses."""

import numpy as np


class KernelMemory:
    """Named rows of zero bytes on 64-byte boundaries, and their addresses.

    They are of one allocation: kernels take addresses, and NumPy is slow to tell them.
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
