"""The compiler on its own: plain functions of arrays against NumPy, path by path."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.lanes.compiled import run

from snapo.lanes import Unsupported
from snapo.lanes.machine.pipeline import host


def paths(*shape: int, seed: int = 0) -> np.ndarray:
    lanes = host().lanes("float32")
    return np.random.default_rng(seed).normal(size=(lanes, *shape)).astype(np.float32)


@pytest.mark.parametrize("size", [3, 12, 13, 40])
def test_elementwise_in_registers_and_in_loops(size):
    """Up to 12 numbers lie in registers, more of them in memory."""
    x, y = paths(size), paths(size, seed=1)
    (found,) = run(lambda x, y: jnp.where(x > y, x * y - 1, x / 4), x, y)
    x, y = x.astype(np.float64), y.astype(np.float64)  # x * y - 1 is rounded once
    np.testing.assert_allclose(found, np.where(x > y, x * y - 1, x / 4), rtol=1e-6)


def test_a_dot_product_hands_its_sums_to_the_loop_that_reads_them():
    matrix, x = paths(20, 17), paths(17, seed=1)
    (found,) = run(lambda m, x: 2 * (m @ x) + 1, matrix, x)
    np.testing.assert_allclose(found, 2 * np.einsum("pij,pj->pi", matrix, x) + 1, rtol=1e-4)


def test_reductions_sorts_and_gathers():
    x = paths(5)
    sums, ordered, chosen = run(lambda x: (x.sum(), jnp.sort(x), x[jnp.argmax(x)]), x)
    np.testing.assert_allclose(sums, x.sum(1), rtol=1e-5)
    np.testing.assert_array_equal(ordered, np.sort(x, 1))
    np.testing.assert_array_equal(chosen, x.max(1))


def test_a_reason_names_the_primitive_and_the_line():
    with pytest.raises(Unsupported, match=r"sort: 100 numbers.*test_operations\.py"):
        run(lambda x: jnp.sort(x), paths(100))
