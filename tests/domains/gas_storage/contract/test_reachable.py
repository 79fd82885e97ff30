"""The reachable inventories where round numbers tie: whose derivative it is."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.gas_storage.contract.reachable import InventoryLimits, reachable

DAYS = 2


@partial(jax.jit, static_argnums=2)
def highest(capacity, row, interpolation):
    """The greatest inventory at the start, of a store that may end with anything."""
    days = jnp.ones(DAYS)
    rows = jnp.outer(days, jnp.stack([jnp.zeros_like(row), row]))
    limits = InventoryLimits(
        0 * days,
        capacity * days,
        0 * days,
        rows,
        0 * rows + 3.0,
        0 * rows + 2.0,
        0 * days,
        0 * days,
    )
    return reachable(limits, jnp.zeros_like(row), capacity, interpolation)[1][0]


@pytest.mark.parametrize("interpolation", ["linear", pytest.param("step", marks=pytest.mark.prove)])
def test_a_ratchet_row_at_the_capacity_leaves_the_derivative_to_the_capacity(interpolation):
    """One unit more and one unit less of capacity are both worth one; of the row, nothing."""
    with jax.enable_x64(True):
        at = np.float64(10.0)
        found = [float(x) for x in jax.grad(highest, (0, 1))(at, at, interpolation)]
        values = [float(highest(at + step, at, interpolation)) for step in (-0.5, 0.0, 0.5)]
    assert found == [1.0, 0.0]
    assert np.diff(values) == pytest.approx([0.5, 0.5], abs=1e-6)
