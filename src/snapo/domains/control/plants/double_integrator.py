"""A mass on a line, pushed to its target by a bounded force."""

import jax.numpy as jnp
import numpy as np

from ..kinds import DoubleIntegratorKind
from .plant import Plant


class DoubleIntegrator(DoubleIntegratorKind, Plant):
    """position' = position + speed dt, speed' = speed + force dt / mass.

    The cost of a step is position^2 + speed^2 + force^2, each with its weight; the terminal state
    costs `final` times the cost of such a state in a step. If the bound on the force has no effect,
    the best rule is linear.
    """

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
