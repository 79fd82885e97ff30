"""Matrix products so small that BLAS starts no threads, which would wait on each other and ours."""

import numpy as np

MAXIMUM = 1 << 18  # multiplications; OpenBLAS takes one thread below


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """left [n, k] @ right [k, m], some columns at a time."""
    wide = max(MAXIMUM // max(left.size, 1), 1)
    if right.shape[1] <= wide:
        return left @ right
    result = np.empty((len(left), right.shape[1]))
    for first in range(0, right.shape[1], wide):
        block = slice(first, first + wide)
        np.matmul(left, right[:, block], out=result[:, block])
    return result
