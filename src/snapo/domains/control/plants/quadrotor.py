"""A quadrotor in the plane: two rotors, brought to hover at a place."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Box

from .plant import Plant, PlantParameter, Variable, runge_kutta


class Quadrotor(Plant):
    """x'' = -(F1 + F2) sin(tilt) / m, z'' = (F1 + F2) cos(tilt) / m - g,
    tilt'' = (F1 - F2) arm / inertia; Runge-Kutta of order 4. Each rotor lifts 0 to `thrust`.

    A step costs the squares of all states, and of the rotors' distance to hovering in shares of
    `thrust`, each with its weight.
    """

    type: ClassVar = "quadrotor"
    description: ClassVar = "a quadrotor in the plane, flown to its target"
    steps: ClassVar = 80
    parameters: ClassVar = {
        "mass": PlantParameter(0.5, "kg", "mass"),
        "inertia": PlantParameter(0.002, "kg m2", "moment of inertia"),
        "arm": PlantParameter(0.15, "m", "distance of a rotor to the middle"),
        "gravity": PlantParameter(9.81, "m/s2", "gravity"),
        "thrust": PlantParameter(4.905, "N", "largest thrust of a rotor"),
        "step": PlantParameter(0.03, "s", "time step"),
    }
    weights: ClassVar = {
        "place": PlantParameter(1.0, "1/m2", "weight of the squared distance to the target", False),
        "speed": PlantParameter(0.1, "s2/m2", "weight of the squared speed", False),
        "tilt": PlantParameter(0.1, "1/rad2", "weight of the squared tilt", False),
        "spin": PlantParameter(0.01, "s2/rad2", "weight of the squared spin", False),
        "thrust": PlantParameter(0.1, "1", "weight of the squared distance to hovering", False),
    }
    states: ClassVar = {
        "x": Variable("m", "place to the right", {"mean": 0.0, "deviation": 1.0}),
        "z": Variable("m", "height", {"mean": 0.0, "deviation": 1.0}),
        "tilt": Variable("rad", "tilt to the left", {"mean": 0.0, "deviation": 0.3}),
        "vx": Variable("m/s", "speed to the right", {"mean": 0.0, "deviation": 0.3}),
        "vz": Variable("m/s", "speed upward", {"mean": 0.0, "deviation": 0.3}),
        "spin": Variable("rad/s", "angular speed", {"mean": 0.0, "deviation": 0.3}),
    }
    actions: ClassVar = {
        "right": Variable("N", "thrust of the right rotor"),
        "left": Variable("N", "thrust of the left rotor"),
    }

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
