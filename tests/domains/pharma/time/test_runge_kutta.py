"""Derivatives of all steps at once: against step by step, differences, and a second time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.pharma.time.runge_kutta import final_state, runge_kutta

STEPS = 11  # fills no whole number of blocks


def inputs(x):
    """An oscillator with friction x[0], pushed by a drive; x[1] starts it, x[2] is the time."""

    def rate(y, drive):
        return jnp.stack([y[1], x[0] * (1 - y[0] ** 2) * y[1] - y[0] + drive[0]])

    step = x[2] / STEPS * (1 + 0.5 * jnp.sin(jnp.arange(STEPS)))
    drive = jnp.sin(x[1] + jnp.arange(STEPS * 3).reshape(STEPS, 3, 1) / 9)
    return rate, jnp.stack([x[1], x[1] ** 2]), step, drive


@jax.jit
def at_once(x):
    return final_state(*inputs(x))


@jax.jit
def step_by_step(x):
    rate, start, step, drive = inputs(x)
    return jax.lax.scan(lambda y, now: (runge_kutta(rate, y, *now), None), start, (step, drive))[0]


loop = jax.jit(jax.jacfwd(step_by_step))


@pytest.fixture
def x():
    with jax.enable_x64(True):
        yield jnp.array([1.3, 0.7, 2.0])


@pytest.mark.prove
@pytest.mark.parametrize("mode", [jax.jacrev, jax.jacfwd])
def test_first_derivatives(x, mode):
    found = jax.jit(mode(at_once))(x)
    np.testing.assert_allclose(at_once(x), step_by_step(x), rtol=1e-15)
    np.testing.assert_allclose(found, loop(x), rtol=1e-12)
    step = 1e-5
    columns = [(at_once(x + step * e) - at_once(x - step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(found, np.stack(columns, 1), atol=1e-9)


@pytest.mark.prove
def test_second_derivatives(x):
    """Forward over reverse; reverse over reverse is that of the loop."""
    known = jax.jit(jax.jacfwd(jax.jacfwd(step_by_step)))(x)
    found = jax.jit(jax.jacfwd(jax.jacrev(at_once)))(x)
    np.testing.assert_allclose(found, known, rtol=1e-11, atol=1e-12)
    again = jax.jit(jax.jacrev(jax.jacrev(at_once)))(x)
    np.testing.assert_allclose(again, known, rtol=1e-11, atol=1e-12)


@pytest.mark.prove
def test_side_by_side(x):
    many = jnp.stack([x, 1.1 * x])
    found = jax.jit(jax.vmap(jax.jacrev(at_once)))(many)
    np.testing.assert_allclose(found[1], loop(many[1]), rtol=1e-12)
