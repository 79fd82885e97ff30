"""This processor: its name, its features, and the width of its vectors."""

from functools import cache
from typing import NamedTuple

import numpy as np

from .llvm import binding

REGISTERS = 2  # per number and block: two chains side by side hide part of the latency


class Processor(NamedTuple):
    """A processor as LLVM knows it; `register` are the bytes of a vector register."""

    triple: str
    name: str
    features: str
    register: int

    def lanes(self, dtype: str) -> int:
        """Paths in one block: two vector registers of them."""
        return max(1, self.register // np.dtype(dtype).itemsize) * REGISTERS


@cache
def host() -> Processor:
    """The processor that this process runs on."""
    llvm = binding()
    features = llvm.get_host_cpu_features()
    wide = features.get("avx512f") and features.get("avx512dq") and features.get("avx512vl")
    register = 64 if wide else 32 if features.get("avx2") else 16
    name = llvm.get_host_cpu_name()
    return Processor(llvm.get_default_triple(), name, features.flatten(), register)
