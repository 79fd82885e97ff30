"""Exogenous dynamics: the ready factor price against closed forms, and one of a user's own."""

import importlib.util
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import snapo
from snapo.engine import Xla
from snapo.problem.problem import prepare
from snapo.problem.process import FactorPrice, Factors, Process, Schwartz
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, at
from snapo.problem.smooth import Exact

TIMES = (0.25, 0.5, 0.75, 2.0)


class TwoFactors(FactorPrice):
    """A fast and a lasting factor, correlated."""

    times: tuple[float, ...] = eqx.field(static=True, default=TIMES)
    time_scale: float = eqx.field(static=True, default=1.0)
    noise_size: int = eqx.field(static=True, default=2)

    def parameters(self, inputs) -> Factors:
        loading = jnp.broadcast_to(jnp.array([0.8, 0.3]), (len(self.times), 2))
        correlation = jnp.array([[1.0, -0.5], [-0.5, 1.0]])
        return Factors(inputs, jnp.array([5.0, 0.0]), loading, correlation)

    def describe(self):
        return "two factors"


def states(process, schedule, count, seed=0):
    """[T, count, F] states of simulated paths."""
    noise = np.random.default_rng(seed).normal(size=(len(TIMES), count, process.noise_size))
    found = [jax.jit(jax.vmap(lambda z: process.initial(schedule.constants, z)))(noise[0])]
    move = jax.vmap(partial(process.step, schedule.constants), in_axes=(None, 0, 0))
    move = jax.jit(move)
    for t in range(len(TIMES) - 1):
        found.append(move(at(schedule.steps, t), found[-1], noise[t + 1]))
    return np.array(found)


@pytest.mark.prove
def test_factors_have_their_exact_covariance_over_any_interval():
    """Cov(f_i, f_j) = rho (1 - exp(-(a_i + a_j) t)) / (a_i + a_j), whatever the steps between."""
    count, process = 200_000, TwoFactors()
    with jax.enable_x64(True):
        schedule = jax.jit(process.prepare)(jnp.array([10.0, 11.0, 12.0, 13.0]))
        found = states(process, schedule, count)
        level = jax.vmap(partial(process.level, schedule.constants), in_axes=(None, 0))
        level = jax.jit(level)
        levels = [level(at(schedule.steps, t), found[t]) for t in range(len(TIMES))]
    for t, time in enumerate(TIMES):
        fast, slow = -np.expm1(-10 * time) / 10, time
        cross = -0.5 * -np.expm1(-5 * time) / 5
        expected = np.array([[fast, cross], [cross, slow]])
        # A sample covariance of normals has an error of at most sqrt(2 / count) of its scale.
        error = 4.5 * np.sqrt(2 / count) * np.sqrt(np.outer([fast, slow], [fast, slow]))
        assert np.all(np.abs(np.cov(found[t].T) - expected) < error)
        variance = 0.64 * fast + 0.09 * slow + 2 * 0.24 * cross
        assert_allclose(schedule.steps.variance[t], variance, rtol=1e-12)
        spots = np.asarray(levels[t])
        assert abs(spots.mean() - (10 + t)) < 4.5 * spots.std() / np.sqrt(count)
        assert_allclose(np.log(spots).var(), variance, rtol=0.02)


@pytest.mark.prove
def test_at_time_zero_the_price_is_the_forward_price():
    process = Schwartz((0, 1, 3))
    inputs = type("Inputs", (), {"forward": jnp.array([5.0, 6.0, 7.0])})
    inputs.volatility, inputs.mean_reversion = jnp.asarray(0.4), jnp.asarray(0.0)
    schedule = jax.jit(lambda: process.prepare(inputs))()
    state = jax.jit(process.initial)(schedule.constants, jnp.ones(1))
    now = at(schedule.steps, 0)
    for function, exact in ((process.level, 5.0), (process.innovation, 0.0)):
        assert float(jax.jit(function)(schedule.constants, now, state)) == exact
    # Without reversion the factor is a Brownian motion: two units of time at once.
    assert_allclose(at(schedule.steps, 1).next_shock[0, 0], np.sqrt(2), rtol=1e-6)


def test_a_process_that_forgets_a_part_cannot_be_made():
    class Half(Process):
        noise_size: int = 1

        def initial(self, constants, noise):
            return jnp.zeros(())

    with pytest.raises(TypeError):
        Half()


class Walk(Process):
    """A price of one's own in five lines: a random walk that starts at the forward curve."""

    noise_size: int = 1
    martingale: bool = True

    def prepare(self, inputs):
        return Schedule(inputs.volatility, inputs.forward)

    def initial(self, constants, noise):
        return jnp.zeros((1,))

    def step(self, constants, now, state, noise):
        return state + constants * noise

    def level(self, constants, now, state):
        return now + state[0]

    def forward(self, constants, now):
        return now

    def observe(self, constants, now, state):
        return state / 10

    def describe(self):
        return "a random walk"


@pytest.mark.prove
def test_a_battery_takes_any_price():
    """The example's battery earns the price that it is given, energy and gradients included."""
    file = Path(__file__).parents[2] / "examples" / "battery.py"
    spec = importlib.util.spec_from_file_location("battery", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    battery, inputs = module.Battery(price=Walk()), module.inputs()
    schedule, count = prepare(battery, inputs), 8
    actions = np.random.default_rng(0).uniform(-1, 1, (battery.horizon, count, 1))
    draws = Pseudo(0).draws(np.arange(count), battery)
    rolled = Xla("float64").values(
        battery, None, schedule, draws, Exact(), actions=actions, record=("state", "outputs")
    )
    walk = np.asarray(rolled.record["state"]["price"])[..., 0]
    energy = np.asarray(rolled.record["state"]["energy"])
    spot = inputs.price.forward.value[:, None] + walk
    assert walk.std(axis=1)[-1] > 0.3
    assert energy.min() >= -1e-12
    cash = np.asarray(rolled.record["outputs"]["cash"])
    traded = cash / spot
    assert np.all(np.abs(traded) <= inputs.power.value + 1e-9)
    assert isinstance(snapo.check(battery, inputs, paths=4).ok, bool)
