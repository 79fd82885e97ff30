"""Cart and pole: swing the pole up from hanging, and hold it there."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from snapo.problem.angle import angle_features

from .plant import Plant, PlantParameter, Variable, runge_kutta


class CartPole(Plant):
    """A uniform rod of length l and mass m on a cart of mass M, pushed by a force u.

    With the angle a from upright and h = m l / 2,
    (M + m) x'' + h (a'' cos a - a'^2 sin a) = u - friction x',
    (m l^2 / 3) a'' + h x'' cos a = h g sin a;
    one step of Runge and Kutta of order 4. Masses and limits are those of Deisenroth and
    Rasmussen, PILCO (2011). A step costs position^2 + angle 2 (1 - cos a) + speed^2 + spin^2 +
    force^2, each with its weight.
    """

    type: ClassVar = "cart-pole"
    description: ClassVar = "a cart that swings its pole up and balances it"
    steps: ClassVar = 100
    portrait: ClassVar = ("angle", "spin")
    parameters: ClassVar = {
        "cart": PlantParameter(0.5, "kg", "mass of the cart"),
        "pole": PlantParameter(0.5, "kg", "mass of the pole"),
        "length": PlantParameter(0.6, "m", "length of the pole"),
        "friction": PlantParameter(0.1, "N s/m", "friction of the cart", False),
        "gravity": PlantParameter(9.82, "m/s2", "gravity"),
        "force": PlantParameter(10.0, "N", "largest force"),
        "step": PlantParameter(0.05, "s", "time step"),
    }
    weights: ClassVar = {
        "position": PlantParameter(0.5, "1/m2", "weight of the squared position", False),
        "angle": PlantParameter(1.0, "1", "weight of 2 (1 - cos angle)", False),
        "speed": PlantParameter(0.01, "s2/m2", "weight of the squared speed", False),
        "spin": PlantParameter(0.01, "s2/rad2", "weight of the squared spin", False),
        "force": PlantParameter(0.001, "1/N2", "weight of the squared force", False),
    }
    states: ClassVar = {
        "position": Variable("m", "position", {"mean": 0.0, "deviation": 0.1}),
        "angle": Variable("rad", "angle from upright", {"mean": np.pi, "deviation": 0.1}, True),
        "speed": Variable("m/s", "speed of the cart", {"mean": 0.0, "deviation": 0.1}),
        "spin": Variable("rad/s", "angular speed", {"mean": 0.0, "deviation": 0.1}),
    }
    actions: ClassVar = {"force": Variable("N", "force on the cart")}

    def drive(self, p, action):
        return p["force"] * action

    def move(self, p, state, u, smooth):
        return runge_kutta(lambda at: slopes(p, at, u[0]), state, p["step"])

    def cost(self, w, p, state, u):
        return {
            "position": w["position"] * state["position"] ** 2,
            "angle": w["angle"] * 2 * (1 - jnp.cos(state["angle"])),
            "speed": w["speed"] * state["speed"] ** 2,
            "spin": w["spin"] * state["spin"] ** 2,
            "force": w["force"] * u[0] ** 2,
        }

    def features(self, p, state):
        position = jnp.stack([state["position"], state["speed"] / 2])
        return jnp.concatenate([position, angle_features(state["angle"]), state["spin"][None] / 5])

    def recover(self, p, features):
        x, v, cosine, sine, spin = features[:5]
        angle = jnp.arctan2(sine, cosine)
        return {"position": x, "angle": angle, "speed": 2 * v, "spin": 5 * spin}


def slopes(p, at, force):
    """The time derivatives of all states."""
    sine, cosine, mass = jnp.sin(at["angle"]), jnp.cos(at["angle"]), p["pole"]
    lever, inertia = mass * p["length"] / 2, mass * p["length"] ** 2 / 3
    total, turn = p["cart"] + mass, lever * p["gravity"] * sine
    push = force - p["friction"] * at["speed"] + lever * at["spin"] ** 2 * sine
    determinant = total * inertia - (lever * cosine) ** 2
    return {
        "position": at["speed"],
        "angle": at["spin"],
        "speed": (inertia * push - lever * cosine * turn) / determinant,
        "spin": (total * turn - lever * cosine * push) / determinant,
    }
