"""Angles without their full turns: values, derivatives, both engines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import snapo
from snapo.engine import Native, Xla
from snapo.solver.adjoint import value_and_gradient

ANGLES = st.floats(-500, 500, allow_subnormal=False)
TURNS = st.integers(-50, 50)


@pytest.mark.prove
@given(ANGLES, TURNS)
def test_a_full_turn_more_is_the_same_angle(angle, turns):
    """In float64: within -pi and pi, on the same place of the circle, whatever the turns."""
    with jax.enable_x64(True):
        found = float(snapo.wrap_angle(angle))
        more = float(snapo.wrap_angle(angle + turns * 2 * np.pi))
        circle = np.asarray(snapo.angle_features(angle))
    rounding = 1e-12
    assert -np.pi - rounding <= found < np.pi + rounding
    assert np.cos(found) == pytest.approx(circle[0], abs=rounding)
    assert np.sin(found) == pytest.approx(circle[1], abs=rounding)
    # At the edge one of both may be there, and the other half a turn away.
    assert np.cos(more - found) == pytest.approx(1, abs=rounding)
    if abs(angle) < np.pi:
        assert found == angle


def cost(x):
    return snapo.wrap_angle(x) ** 2


slopes = jax.jit(
    lambda x: [
        jax.grad(snapo.wrap_angle)(x),
        jax.grad(jax.grad(snapo.wrap_angle))(x),
        jax.grad(cost)(x) - 2 * snapo.wrap_angle(x),
        jax.hessian(cost)(x),
        *jax.jacobian(snapo.angle_features)(x),
    ]
)


@given(ANGLES)
def test_the_derivative_is_one_and_the_second_nothing(angle):
    """The square is a cost: its slope is twice the wrapped angle, its curvature 2."""
    with jax.enable_x64(True):
        found = np.array(slopes(angle))
    expected = np.array([1, 0, 0, 2, -np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_what_is_no_number_stays_so_and_disturbs_no_other():
    given = jnp.array([np.nan, np.inf, 4.0])
    found, slope = snapo.wrap_angle(given), jax.grad(lambda x: snapo.wrap_angle(x)[2])(given)
    assert np.isnan(found[:2]).all() and found[2] == pytest.approx(4 - 2 * np.pi, rel=1e-6)
    assert slope.tolist() == [0, 0, 1]


def test_edges_and_shapes():
    with jax.enable_x64(True):
        edges = snapo.wrap_angle(np.pi * np.array([1.0, -1.0, 3.0, -3.0]))
        assert np.asarray(edges) == pytest.approx(-np.pi, rel=1e-12)
        assert snapo.angle_features(np.zeros((3, 2))).shape == (3, 2, 2)
    assert snapo.wrap_angle(np.float32(7)).dtype == jnp.float32
    assert float(snapo.wrap_angle(7)) == pytest.approx(7 - 2 * np.pi, rel=1e-6)


class Wheel(snapo.Simulator):
    """A wheel that turns several times on most paths."""

    horizon: int = 8
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    noise_size: int = 1
    initial_noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(self.horizon)})

    def initial(self, constants, noise):
        return 4 * noise[0]

    def observe(self, constants, now, state):
        return snapo.angle_features(state - constants["target"])

    def step(self, constants, now, state, action, noise, smooth):
        after = state + constants["speed"] * action[0] + 2 * noise[0]
        return after, {"cost": snapo.wrap_angle(after - constants["target"]) ** 2}


@pytest.mark.prove
@pytest.mark.parametrize("precision, near", [("float32", 2e-5), ("float64", 1e-11)])
def test_both_engines_wrap_and_differentiate_alike(precision, near):
    inputs = {"speed": snapo.Input(1.5), "target": snapo.Input(0.7)}
    problem = snapo.Problem(Wheel(), inputs, -snapo.Mean("cost"))
    rule = snapo.Linear([[0.3, -0.8]], 0.1, snapo.Box(-1.0, 1.0))
    (value, slope), (other, theirs) = (
        value_and_gradient(problem, rule, paths=256, engine=engine(precision))
        for engine in (Xla, Native)
    )
    assert other == pytest.approx(value, rel=near)
    for name in inputs:
        assert theirs.inputs[name] == pytest.approx(slope.inputs[name], rel=near * 10, abs=near)
    if precision == "float64":
        for name in inputs:
            given = inputs[name].value
            up, down = (
                value_and_gradient(problem.at({name: given + h}), rule, paths=256)[0]
                for h in (1e-6, -1e-6)
            )
            assert slope.inputs[name] == pytest.approx((up - down) / 2e-6, rel=1e-5)
