"""Constant mix with an outflow: moments and their derivatives from an exact recursion.

Two classes, R jointly lognormal by month, 50/50 every month, A' = A (w.R) - 0.5 from 100. With
m = w.E[R] and s = E[(w.R)^2]: E[A'] = m E[A] - 0.5, E[A'^2] = s E[A^2] - m E[A] + 0.25.
"""

import itertools
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Xla
from snapo.problem.actions import Simplex
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo, Supplied
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back

ENGINE = Xla(precision="float64")
MIX = Constant(np.array([0.5, 0.5]))


class Inputs(eqx.Module):
    """Means, volatilities and correlation per year, assets and the monthly outflow."""

    mean: Input
    volatility: Input
    correlation: Input
    assets: Input
    outflow: Input


def inputs():
    """S = [[.0324, -.0018], [-.0018, .0036]]: volatilities 18 % and 6 %, correlation -1/6."""
    return Inputs(Input([0.06, 0.03]), Input([0.18, 0.06]), Input(-1 / 6), Input(100.0), Input(0.5))


class Mix(Simulator):
    """Assets rebalanced to the action's weights each month."""

    horizon: int = 120
    action: Simplex = Simplex(2)
    noise_size: int = 2

    def prepare(self, inputs):
        rho = inputs.correlation
        factor = inputs.volatility[:, None] * jnp.array([[1.0, 0.0], [rho, jnp.sqrt(1 - rho**2)]])
        constants = {
            "drift": (inputs.mean - inputs.volatility**2 / 2) / 12,
            "factor": factor / jnp.sqrt(12.0),
            "assets": inputs.assets,
        }
        return Schedule(constants, {"outflow": jnp.full(self.horizon, 1.0) * inputs.outflow})

    def initial(self, constants, noise):
        return constants["assets"]

    def observe(self, constants, now, state):
        return jnp.stack([state / 100])

    def step(self, constants, now, state, action, noise, smooth):
        gross = jnp.exp(constants["drift"] + constants["factor"] @ noise)
        return state * (action @ gross) - now["outflow"], {}

    def terminal(self, constants, state, smooth):
        return {"assets": state, "square": state**2}


def moments(values, months):
    """E[A] and E[A^2] by the recursion, from the inputs' values; JAX, so that it differentiates."""
    mean, volatility, rho, assets, outflow = values
    covariance = jnp.outer(volatility, volatility) * jnp.array([[1.0, rho], [rho, 1.0]])
    gross = jnp.exp(mean / 12)
    m = 0.5 * gross.sum()
    s = 0.25 * jnp.sum(jnp.outer(gross, gross) * jnp.exp(covariance / 12))

    def month(_, both):
        first, second = both
        return m * first - outflow, s * second - 2 * outflow * m * first + outflow**2

    return jnp.stack(jax.lax.fori_loop(0, months, month, (assets, assets**2)))


@cache
def exact(months):
    """The recursion's moments and their Jacobian by every input."""
    values = [
        entry.value for entry in jax.tree.leaves(inputs(), is_leaf=lambda x: isinstance(x, Input))
    ]
    with jax.enable_x64(True):
        both = jax.jit(lambda v: (moments(v, months), jax.jacrev(lambda v: moments(v, months))(v)))
        return jax.tree.map(np.asarray, both(values))


@pytest.mark.prove
def test_the_recursion_is_the_published_one():
    (first, second), _ = exact(120)
    assert first == pytest.approx(81.20917249, abs=1e-8)
    assert np.sqrt(second - first**2) == pytest.approx(34.63918480, abs=1e-8)


@pytest.mark.prove
def test_gradients_of_the_exact_expectation():
    """Two months, every expectation a product of Gauss-Hermite rules of 7 points in 4 dimensions:
    exact to rounding for lognormals this narrow, so value and gradient to 1e-10."""
    simulator = Mix(horizon=2)
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    points = np.array(list(itertools.product(nodes, repeat=4)))
    weight = np.prod(list(itertools.product(weights / np.sqrt(2 * np.pi), repeat=4)), axis=1)
    schedule = prepare(simulator, inputs())
    draws = Supplied(points.reshape(-1, 2, 2).transpose(1, 0, 2)).draws(np.arange(7**4), simulator)
    nothing = np.zeros_like(weight)
    each = {"assets": np.stack([weight, nothing]), "square": np.stack([nothing, weight])}
    out = ENGINE.adjoint(simulator, MIX, schedule, draws, Exact(), each)
    moved = pull_back(
        simulator,
        inputs(),
        [jax.tree.map(lambda leaf, k=k: leaf[k], out.schedule) for k in range(2)],
    )
    expected, jacobian = exact(2)
    got = [weight @ out.totals["assets"], weight @ out.totals["square"]]
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    for name, slope in zip(("mean", "volatility", "correlation", "assets", "outflow"), jacobian):
        np.testing.assert_allclose(moved[name], slope, rtol=1e-9, atol=1e-9 * np.abs(slope).max())


@pytest.mark.prove
def test_moments_and_gradients_of_ten_years_by_simulation():
    """32 blocks of 512 antithetic paths: each of 2 moments and 14 derivatives within 3.5 standard
    errors (16 statements of one sample), the mean's standard error below 0.5 %."""
    simulator, scenarios = Mix(), Pseudo(2)
    schedule, size = prepare(simulator, inputs()), 32 * 512
    draws = scenarios.draws(np.arange(size), simulator)
    weights = np.zeros((32, size))
    for k, block in enumerate(scenarios.blocks(size)):
        weights[k, block] = 1 / block.size
    expected, jacobian = exact(120)
    rows = {"assets": [weights, 0 * weights], "square": [0 * weights, weights]}
    rows = {output: np.concatenate(parts) for output, parts in rows.items()}
    out = ENGINE.adjoint(simulator, MIX, schedule, draws, Exact(), rows)
    parts = [jax.tree.map(lambda leaf, k=k: leaf[k], out.schedule) for k in range(64)]
    moved = pull_back(simulator, inputs(), parts)
    for j, output in enumerate(rows):
        blocks = {"value": weights @ out.totals[output]}
        blocks |= {name: slopes[32 * j : 32 * (j + 1)] for name, slopes in moved.items()}
        names = ("value", "mean", "volatility", "correlation", "assets", "outflow")
        for name, truth in zip(names, [expected[j], *(slope[j] for slope in jacobian)]):
            error = blocks[name].std(axis=0, ddof=1) / np.sqrt(32)
            assert np.all(
                np.abs(blocks[name].mean(0) - truth) < 3.5 * error + 1e-9 * np.abs(truth).max()
            ), name
        assert blocks["value"].std(ddof=1) / np.sqrt(32) < 0.02 * blocks["value"].mean()
