"""A path's own adjoint: the share of it that goes on at each step back, against a closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Native, Xla
from snapo.problem.policies.rules import Linear
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

STEPS, PATHS, GROWS, PUSHES, LAST = 6, 8, 1.3, 0.7, 2.0


class Line(Simulator):
    """x' = 1.3 x + .7 u + noise; each step earns x - u^2 / 2, the end 2 x."""

    horizon: int = STEPS
    action: snapo.Box = snapo.Box(-np.inf, np.inf)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({}, {"t": jnp.zeros(self.horizon)})

    def initial(self, constants, noise):
        return {"x": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.ones(1)

    def step(self, constants, now, state, action, noise, smooth):
        x, u = state["x"], action[0]
        return {"x": GROWS * x + PUSHES * u + noise[0]}, {"value": x - u**2 / 2}

    def terminal(self, constants, state, smooth):
        return {"value": LAST * state["x"]}


def closed(push, keep):
    """The derivative by a constant push: of its own step, and of all that comes after it."""
    ahead, found = LAST, 0.0
    for _ in range(STEPS):
        found += PUSHES * ahead - push
        ahead = keep * (1 + GROWS * ahead)
    return found


PROBLEM = Problem(Line(), {}, snapo.Mean("value"))
DRAWS = Pseudo(0).draws(np.arange(PATHS), PROBLEM.simulator)


def derivative(engine, push, clip):
    weights = {"value": np.full(PATHS, 1 / PATHS)}
    rule = Linear(np.full((1, 1), push))
    found = engine("float64").bind(PROBLEM).adjoint(rule, DRAWS, Exact(), weights, clip=clip)
    return float(found.policy.gain[0, 0])


@pytest.mark.parametrize("engine", [Xla, Native], ids=["xla", "native"])
def test_an_outcome_k_steps_later_counts_keep_to_the_k(engine):
    for keep in (1.0, 0.9, 0.5, 0.0):
        found = derivative(engine, 0.5, snapo.Clip(keep=keep))
        assert found == pytest.approx(closed(0.5, keep), rel=1e-12)
    assert derivative(engine, 0.5, None) == pytest.approx(closed(0.5, 1.0), rel=1e-12)


@pytest.mark.parametrize("engine", [Xla, Native], ids=["xla", "native"])
def test_a_bound_holds_for_the_share_that_is_kept(engine):
    """Every adjoint on the way, 1.28 at least, is cut to 1.2; the end's own goes back as it is."""
    found = derivative(engine, 0.0, snapo.Clip(1.2, keep=0.5))
    assert found == pytest.approx(PUSHES * (LAST + 1.2 * (STEPS - 1)), rel=1e-12)


def test_a_path_without_weight_is_no_fault():
    """Its bound is 0, not infinity times 0."""
    bounds = snapo.Clip(keep=0.9).bounds({"value": np.array([0.0, 0.5])})
    np.testing.assert_array_equal(bounds, [[0.0, 0.9], [np.inf, 0.9]])


@pytest.mark.parametrize(
    "given, said", [({"norm": 0.0}, "norm is 0.0; it must be a number above 0"),
                    ({"keep": 1.1}, "keep is 1.1; it must be a number from 0 to 1"),
                    ({"keep": np.nan}, "keep is nan")],
)  # fmt: skip
def test_what_is_no_clip_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        snapo.Clip(**given)
