"""A quadrotor in the plane: two rotors, which learn to hover at a target."""

import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Box

from ..kinds import QuadrotorKind
from .plant import Plant, runge_kutta


class Quadrotor(QuadrotorKind, Plant):
    """x'' = -(F1 + F2) sin(tilt) / m, z'' = (F1 + F2) cos(tilt) / m - g, tilt'' = (F1 - F2) arm /
    inertia; Runge-Kutta of order 4. The force of each rotor is 0 to `thrust`. The cost of a step is
    a weighted sum of the squares of all states and of the forces of the rotors minus their forces
    in hovering, as shares of `thrust`.
    """

    def decisions(self, inputs):
        return Box(-1.0, 1.0, 2)

    def drive(self, p, action):
        return p["thrust"] * (action + 1) / 2

    def move(self, p, state, u, smooth):
        return runge_kutta(lambda at: slopes(p, at, u), state, p["step"])

    def cost(self, w, p, state, u):
        away = (u - p["mass"] * p["gravity"] / 2) / p["thrust"]
        return {
            "place": w["place"] * (state["x"] ** 2 + state["z"] ** 2),
            "speed": w["speed"] * (state["vx"] ** 2 + state["vz"] ** 2),
            "tilt": w["tilt"] * state["tilt"] ** 2,
            "spin": w["spin"] * state["spin"] ** 2,
            "thrust": w["thrust"] * jnp.sum(away**2),
        }

    def features(self, p, state):
        return jnp.stack([state["x"], state["z"], state["tilt"], state["vx"], state["vz"],
                          state["spin"] / 5])  # fmt: skip

    def recover(self, p, features):
        x, z, tilt, vx, vz, spin = features[:6]
        return {"x": x, "z": z, "tilt": tilt, "vx": vx, "vz": vz, "spin": 5 * spin}

    def rest(self, p):
        return np.full(2, float(p["mass"] * p["gravity"]) / 2)


def slopes(p, at, u):
    """The time derivatives of all states; u: thrust of the right and of the left rotor."""
    lift = (u[0] + u[1]) / p["mass"]
    return {
        "x": at["vx"],
        "z": at["vz"],
        "tilt": at["spin"],
        "vx": -lift * jnp.sin(at["tilt"]),
        "vz": lift * jnp.cos(at["tilt"]) - p["gravity"],
        "spin": (u[0] - u[1]) * p["arm"] / p["inertia"],
    }
