"""Prices of two commodities against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.energy.energy_cases import plain, plant

from snapo.domains.energy.setup import bare_problem

SPEEDS, RHO, HOUR = np.array([525.6, 20.0]), 0.4, 1 / 8760


def prices():
    """The process of the template, and its inputs."""
    problem = bare_problem(plant())
    return problem.simulator.process, {n: x.value for n, x in problem.inputs_by_name.items()}


def covariance(time):
    """Of both factors after a time: rho (1 - exp(-(a + b) t)) / (a + b)."""
    pair = SPEEDS[:, None] + SPEEDS
    return np.where(np.eye(2), 1.0, RHO) * (1 - np.exp(-pair * time)) / pair


def test_covariance_of_a_step_is_exact():
    """Of the shocks of an hour, and of the factors after three days."""
    process, inputs = prices()
    with jax.enable_x64(True):
        of = process.factors(plain(jax.jit(process.prepare)(jax.tree.map(jnp.asarray, inputs))))
    assert np.allclose(of.shock[0], 0.0, atol=1e-15)  # the first hour is today
    assert np.allclose(of.shock[5] @ of.shock[5].T, covariance(HOUR), rtol=1e-12)
    assert np.allclose(of.covariance[72], covariance(72 * HOUR), rtol=1e-12)
    assert np.all(of.loading[:, 1] == 0) and not of.index.carry.any()


@pytest.mark.prove
def test_simulated_prices_have_their_forward_prices_as_means():
    """Both, after 48 hours, with the variances of a closed form; and as dynamic programs read
    them."""
    process, inputs = prices()
    with jax.enable_x64(True):
        schedule = jax.jit(process.prepare)(jax.tree.map(jnp.asarray, inputs))
        draws = jax.random.normal(jax.random.key(0), (48, 40_000, 2))

        def path(draw):
            state = process.initial(schedule.constants, jnp.zeros(process.initial_noise_size))
            rows = jax.tree.map(lambda leaf: leaf[:48], schedule.steps)

            def step(state, row):
                return process.step(schedule.constants, row[0], state, row[1]), None

            return jax.lax.scan(step, state, (rows, draw))[0]

        states = jax.jit(jax.vmap(path, in_axes=1))(draws)
        row = jax.tree.map(lambda leaf: leaf[48], schedule.steps)
        power = jax.vmap(process.level, (None, None, 0))(schedule.constants, row, states)
        gas = jax.vmap(process.index, (None, None, 0))(schedule.constants, row, states)
    of = process.factors(plain(schedule))
    assert np.allclose(of.index.price(of, 48, np.asarray(states)[:, 1]), gas, rtol=1e-12)
    deviation = np.sqrt(np.diagonal(covariance(48 * HOUR))) * (11.2315, 0.6)
    means = float(row.forward), float(row.index.forward)
    for price, forward, spread in zip((power, gas), means, deviation):
        price = np.asarray(price)
        assert abs(price.mean() - forward) < 3 * price.std() / 200
        assert np.log(price).std() == pytest.approx(spread, rel=0.015)


@pytest.mark.prove
def test_derivatives_of_the_second_price():
    """Against central differences, of a price after a shock."""
    process, inputs = prices()
    with jax.enable_x64(True):
        inputs = jax.tree.map(jnp.asarray, inputs)

        @jax.jit
        def price(values):
            schedule = process.prepare(values)
            row, then = (jax.tree.map(lambda x, t=t: x[t], schedule.steps) for t in (0, 1))
            state = process.step(schedule.constants, row, jnp.zeros(2), jnp.array([0.7, -0.9]))
            return process.index(schedule.constants, then, state)

        slopes = jax.grad(price)(inputs)
        for name in ("correlation", "gas_volatility", "gas_mean_reversion", "gas_curve"):
            size = 1e-4 * max(float(np.ravel(inputs[name])[0]), 1.0)
            step = size * jnp.ones_like(inputs[name]) * (jnp.arange(inputs[name].size) == 0)
            sides = [price(inputs | {name: inputs[name] + x}) for x in (step, -step)]
            slope = float(np.ravel(slopes[name])[0])
            assert slope == pytest.approx(float(sides[0] - sides[1]) / (2 * size), rel=1e-6)
