"""A choice that is drawn: its law, and its derivative by the likelihood ratio."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Native
from snapo.problem.actions import Choice
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Linear
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth
from snapo.solver.evaluate import path_totals
from snapo.solver.statistics import mean

GAIN = np.array([[0.8, -0.2], [-0.4, 0.6], [0.1, 0.3]])
SHARES = np.array([0.5, 0.2, 0.3])
PATHS = 1_000_000


class Gears(Simulator):
    """Three gears. What a gear earns jumps with the state, and the state with the gear: a mixture
    of gears is another machine."""

    horizon: int = 3
    action: Choice = Choice(3)
    noise_size: int = 2

    def prepare(self, inputs):
        return Schedule(dict(inputs), {"t": jnp.arange(3.0)})

    def initial(self, constants, noise):
        return {"x": constants["start"], "weight": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"], constants["slope"] * state["x"] ** 2])

    def step(self, constants, now, state, action, noise, smooth):
        gear, likelihood = self.action.draw(action, noise[1])
        weight = state["weight"] * likelihood
        x = state["x"] + gear @ jnp.asarray([-0.7, 0.2, 1.1], noise.dtype) + 0.2 * noise[0]
        cash = gear @ jnp.stack([x**2, 3 * jnp.sin(2 * x), 1 - x])
        return {"x": 0.8 * x, "weight": weight}, {"cash": 1 + weight * (cash - 1)}


INPUTS = {"start": Input(0.3), "slope": Input(0.7)}


def test_the_option_drawn_has_the_probabilities_of_the_action():
    """Frequencies over 40,000 normals within three standard errors."""
    normals = np.random.default_rng(0).normal(size=40_000).astype(np.float32)
    action = jnp.asarray(SHARES, jnp.float32)
    option, likelihood = jax.jit(jax.vmap(lambda n: Choice(3).draw(action, n)))(normals)
    assert np.all(np.asarray(likelihood) == 1) and np.all(np.asarray(option).sum(1) == 1)
    error = np.sqrt(SHARES * (1 - SHARES) / len(normals))
    assert np.all(np.abs(np.asarray(option).mean(0) - SHARES) < 3 * error)


@pytest.mark.prove
@pytest.mark.parametrize("name, step", [("start", 0.02), ("slope", 0.03)])
def test_the_likelihood_ratio_is_unbiased(name, step):
    """By an input that moves the state, and by one that moves the choice alone, for which the
    pathwise derivative is zero: within two standard errors of central differences of the paths
    as drawn, on a million common paths."""
    problem = Problem(Gears(), INPUTS, snapo.Mean("cash"))
    policy, smooth = Linear(GAIN, SHARES, Choice(3)), Smooth(np.float64(0.02))
    engine = Native("float64")
    given = {"smooth": smooth, "engine": engine}
    table = snapo.sensitivities(problem, policy, paths=PATHS, smooth_paths=PATHS, **given).smooth
    found = float(table[name].value), float(table[name].standard_error)
    value = problem.inputs_by_name[name].value
    high, low = (
        path_totals(problem.at({name: value + by}), policy, PATHS, **given)["cash"]
        for by in (step, -step)
    )
    groups = problem.sources.evaluation.groups(np.arange(PATHS))
    slope = mean((high - low) / (2 * step), groups)
    error = np.hypot(found[1], slope.standard_error)
    assert abs(found[0] - slope.value) < 2 * error, (found, slope)
    assert error < 0.05 * abs(slope.value)
