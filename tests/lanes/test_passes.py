"""Passes give the same numbers from fewer operations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.lanes.compiled import run

from snapo.lanes.machine.pipeline import host
from snapo.lanes.program.flatten import flatten
from snapo.lanes.program.passes import optimize

X = np.array([0.3, -1.7, 2.9])

CASES = {
    "a product with one": (lambda x: jnp.sin(x) * jnp.ones(3), ["sin"]),
    "one times a product and a sum": (lambda x: x[0] * x[1] * 1.0 + x[2], None),
    "a sum with a product with one": (lambda x: 1.0 * jnp.exp(x) + x, ["exp", "add"]),
    "less a product with one": (lambda x: x - jnp.exp(x) * 1.0, ["exp", "sub"]),
    "a product with one, less": (lambda x: jnp.exp(x) * 1.0 - x, ["exp", "sub"]),
    "a mask that is known": (
        lambda x: jnp.where(jnp.array([True] * 3), jnp.exp(x), jnp.sin(x)), ["exp"],
    ),
    "another mask": (lambda x: jnp.where(jnp.array([True, False, True]), x, 0.0), ["select_n"]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_operations_left(name):
    function, names = CASES[name]
    with jax.enable_x64(True):
        program = optimize(flatten(jax.make_jaxpr(function)(X), [True]))
        if names is not None:
            assert [op.name for op in program.ops] == names
        lanes = host().lanes("float64")
        paths = np.linspace(0.5, 1.5, lanes)[:, None] * X
        (result,) = run(function, paths)
        expected = np.stack([np.asarray(function(jnp.asarray(x))) for x in paths])
    np.testing.assert_allclose(result.reshape(expected.shape), expected, rtol=1e-14)


def test_a_product_with_one_stays_rounded_before_the_sum():
    """(x y) 1 + z rounds x y first; x y + z does not: the last place must stay as it was."""
    with jax.enable_x64(True):
        closed = jax.make_jaxpr(lambda x: x[0] * x[1] * 1.0 + x[2])(X)
        names = [op.name for op in optimize(flatten(closed, [True])).ops]
    assert "fma" not in names and names[-1] == "add"
