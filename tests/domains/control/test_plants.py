"""The equations of the plants against what they must conserve, and rules at their targets."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants import PLANTS, cart_pole, catalogue, quadrotor
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.plants.plant import runge_kutta
from snapo.domains.control.plants.two_tanks import TwoTanks
from snapo.problem.inputs import plain
from snapo.problem.smooth import Exact


def numbers(plant):
    return plain(make_inputs(plant))["plant"]


def test_an_incomplete_plant_is_refused():
    class Bare(Pendulum):
        type: ClassVar = "pendulum"

    with pytest.raises(TypeError, match="Two plants"):
        catalogue((Pendulum, Bare))
    assert len(catalogue(PLANTS)) == len(PLANTS)


@pytest.mark.prove
def test_cart_and_pole_gain_the_power_of_the_force_less_that_of_friction():
    p, force = numbers(cart_pole.CartPole), 3.0
    lever, inertia = p["pole"] * p["length"] / 2, p["pole"] * p["length"] ** 2 / 3

    def energy(at):
        v, spin, cosine = at["speed"], at["spin"], jnp.cos(at["angle"])
        moving = (p["cart"] + p["pole"]) * v**2 / 2 + lever * cosine * spin * v
        return moving + inertia * spin**2 / 2 + lever * p["gravity"] * cosine

    state = {"position": 0.3, "angle": 1.1, "speed": -0.7, "spin": 2.3}
    with jax.enable_x64(True):
        state = {name: jnp.asarray(x) for name, x in state.items()}
        slopes = cart_pole.slopes(p, state, force)
        gained = float(jax.jvp(energy, (state,), (slopes,))[1])
    power = force * -0.7 - p["friction"] * 0.7**2
    assert gained == pytest.approx(power, rel=1e-12)


@pytest.mark.prove
def test_the_integration_is_of_order_four():
    """x' = x: a step of dt multiplies by 1 + dt + dt^2/2 + dt^3/6 + dt^4/24."""
    found = runge_kutta(lambda at: {"x": at["x"]}, {"x": 1.0}, 0.1)
    assert found["x"] == pytest.approx(np.exp(0.1), abs=1e-7)


@pytest.mark.prove
def test_plants_stay_at_their_targets():
    for plant in PLANTS:
        if not plant.rests or plant.type == "linear-quadratic":
            continue
        inputs = make_inputs(plant)
        made, p = plant(inputs), plain(inputs)["plant"]
        target = {name: jnp.asarray(x) for name, x in made.target_at(p).items()}
        after = made.move(p, target, jnp.asarray(made.rest(p)), Exact())
        for name, x in target.items():
            assert float(after[name]) == pytest.approx(float(x), abs=1e-5), (plant.type, name)


@pytest.mark.prove
def test_what_an_observation_shows_is_the_state():
    for plant in PLANTS:
        if plant.type == "linear-quadratic":
            continue
        inputs = make_inputs(plant)
        made, p = plant(inputs), plain(inputs)["plant"]
        state = {name: jnp.asarray(0.1 * (i + 1)) for i, name in enumerate(plant.states)}
        back = made.recover(p, made.features(p, state))
        for name, x in state.items():
            assert float(back[name]) == pytest.approx(float(x), rel=1e-5), (plant.type, name)


@pytest.mark.prove
def test_tanks_hold_their_water():
    """What the pump gives less what leaves the lower tank is what both gain."""
    p = numbers(TwoTanks)
    from snapo.domains.control.plants.two_tanks import slopes

    at = {"upper": jnp.asarray(7.0), "lower": jnp.asarray(11.0)}
    found = slopes(p, at, 20.0)
    gained = p["area"] * (found["upper"] + found["lower"])
    out = p["lower"] * np.sqrt(2 * p["gravity"] * 11.0)
    assert float(gained) == pytest.approx(20.0 - out, rel=1e-5)


@pytest.mark.prove
def test_a_quadrotor_falls_and_lifts():
    p = numbers(quadrotor.Quadrotor)
    at = {name: jnp.asarray(0.0) for name in quadrotor.Quadrotor.states}
    assert float(quadrotor.slopes(p, at, jnp.zeros(2))["vz"]) == pytest.approx(-9.81)
    hover = jnp.full(2, p["mass"] * p["gravity"] / 2)
    assert float(quadrotor.slopes(p, at, hover)["vz"]) == pytest.approx(0.0, abs=1e-6)
    turned = at | {"tilt": jnp.asarray(0.3)}
    assert float(quadrotor.slopes(p, turned, hover)["vx"]) == pytest.approx(-9.81 * np.sin(0.3))
