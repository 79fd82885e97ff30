"""A jump whose intensity is an input: its derivative by the likelihood of what was drawn."""

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Native
from snapo.problem.policies.rules import Constant
from snapo.problem.smooth import Smooth

STEPS, PATHS, INTENSITY, BY = 4, 1 << 16, 1.5, 0.1
JUMP = snapo.Choice(2)


class Claims(snapo.Simulator):
    """A claim in each quarter with the chance 1 - exp(-intensity / 4); pays for all but the first."""

    horizon: int = STEPS
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, jnp.zeros(STEPS))

    def initial(self, constants, noise):
        return {"claims": jnp.zeros(()), "weight": jnp.ones(())}

    def observe(self, constants, now, state):
        return state["claims"][None]

    def step(self, constants, now, state, action, noise, smooth):
        chance = 1 - jnp.exp(-constants["intensity"] / STEPS)
        drawn, likelihood = JUMP.draw(jnp.stack([1 - chance, chance]), noise[0])
        return {"claims": state["claims"] + drawn[1], "weight": state["weight"] * likelihood}, {}

    def terminal(self, constants, state, smooth):
        return {"paid": state["weight"] * jnp.maximum(state["claims"] - 1, 0.0)}


@pytest.mark.prove
def test_the_derivative_by_an_intensity_is_that_of_jumps_that_are_drawn():
    """Against central differences of a simulation in NumPy, a million common paths."""
    problem = snapo.Problem(Claims(), {"intensity": snapo.Input(INTENSITY)}, snapo.Mean("paid"))
    found = snapo.sensitivities(
        problem, Constant(np.array([0.5])), paths=PATHS, smooth=Smooth(np.float64(0.02)),
        smooth_paths=PATHS, engine=Native("float64"),
    ).smooth["intensity"]  # fmt: skip
    uniform = np.random.default_rng(1).random((1_000_000, STEPS))
    high, low = (
        np.maximum((uniform < 1 - np.exp(-(INTENSITY + by) / STEPS)).sum(1) - 1, 0)
        for by in (BY, -BY)
    )
    slopes = (high - low) / (2 * BY)
    error = np.hypot(slopes.std() / 1000, float(found.standard_error))
    assert abs(slopes.mean() - float(found.value)) < 2 * error, (slopes.mean(), found)
    assert error < 0.03 * slopes.mean()
