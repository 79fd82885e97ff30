"""A mass on a line, pushed by a bounded force to its place."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from .plant import Plant, PlantParameter, Variable


class DoubleIntegrator(Plant):
    """position' = position + speed dt, speed' = speed + force dt / mass.

    The cost of a step is position^2 + speed^2 + force^2, each with its weight; the terminal state
    costs `final` times its own. Where the force has no effective bound, the best rule is linear.
    """

    type: ClassVar = "double-integrator"
    description: ClassVar = "a mass on a line, brought to rest by a bounded force"
    steps: ClassVar = 40
    sees_time: ClassVar = True
    parameters: ClassVar = {
        "mass": PlantParameter(1.0, "kg", "mass"),
        "force": PlantParameter(1.0, "N", "largest force"),
        "step": PlantParameter(0.2, "s", "time step"),
    }
    weights: ClassVar = {
        "position": PlantParameter(1.0, "1/m2", "weight of the squared position", False),
        "speed": PlantParameter(0.1, "s2/m2", "weight of the squared speed", False),
        "force": PlantParameter(0.1, "1/N2", "weight of the squared force", False),
        "final": PlantParameter(1.0, "1", "weight of the last state", False),
    }
    states: ClassVar = {
        "position": Variable("m", "position", {"mean": 1.0, "deviation": 0.5}),
        "speed": Variable("m/s", "speed", {"mean": 0.0, "deviation": 0.5}),
    }
    actions: ClassVar = {"force": Variable("N", "force")}

    def drive(self, p, action):
        return p["force"] * action

    def move(self, p, state, u, smooth):
        position = state["position"] + state["speed"] * p["step"]
        return {"position": position, "speed": state["speed"] + u[0] * p["step"] / p["mass"]}

    def cost(self, w, p, state, u):
        return {**_rest(w, state), "force": w["force"] * u[0] ** 2}

    def final_cost(self, w, p, state):
        return {name: w["final"] * part for name, part in _rest(w, state).items()}

    def features(self, p, state):
        return jnp.stack([state["position"], state["speed"]])

    def recover(self, p, features):
        return {"position": features[0], "speed": features[1]}

    def proportional(self, p):
        omega = 1.0  # 1/s: critically damped
        return {"position": np.array([p["mass"] * omega**2]),
                "speed": np.array([2 * p["mass"] * omega])}  # fmt: skip


def _rest(w, state):
    return {name: w[name] * state[name] ** 2 for name in ("position", "speed")}
