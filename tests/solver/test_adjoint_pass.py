"""Derivatives by adjoint passes of functions without paths."""

import jax
import jax.numpy as jnp
import numpy as np

from snapo.solver.adjoint import adjoint_jacobian


def test_adjoint_jacobian():
    """x y^2 and sum of x: gradients of a number, rows of several, and what comes beside."""
    x, y = np.array([1.0, 2.0, 3.0]), np.array(0.5)

    def function(x, y):
        return jnp.stack([jnp.sum(x) * y**2, jnp.sum(x)]), x.shape

    with jax.enable_x64(True):
        (by_x, by_y), beside = adjoint_jacobian(function, argnums=(0, 1), has_aux=True)(x, y)
        gradient = adjoint_jacobian(lambda x: function(x, y)[0][0])(x)
        second = jax.jacfwd(adjoint_jacobian(lambda y: function(x, y)[0][0]))(y)
    np.testing.assert_allclose(by_x, [[0.25] * 3, [1.0] * 3], rtol=1e-15)
    np.testing.assert_allclose(by_y, [6.0, 0.0], rtol=1e-15)
    np.testing.assert_allclose(gradient, by_x[0], rtol=1e-15)
    assert beside == (3,) and float(second) == 12.0
