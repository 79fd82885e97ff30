"""Gymnasium's Pendulum-v1: a rod on a motor too weak to lift it at once."""

import jax.numpy as jnp
import numpy as np

from snapo.problem.angle import angle_features, wrap_angle

from ..kinds import PendulumKind
from .plant import Plant


class Pendulum(PendulumKind, Plant):
    """A rod of length l and mass m, driven by a torque u of absolute value up to `torque`
    (Gymnasium 1.4).

    speed' = clip(speed + (3 g / (2 l) sin(angle) + 3 u / (m l^2)) dt), angle' = angle + speed' dt;
    the angle is 0 upright. The cost depends on the state before the step: angle^2 (between -pi and
    pi) + 0.1 speed^2 + 0.001 u^2.
    """

    def drive(self, p, action):
        return p["torque"] * action

    def move(self, p, state, u, smooth):
        fall = 1.5 * p["gravity"] / p["length"] * jnp.sin(state["angle"])
        push = 3 / (p["mass"] * p["length"] ** 2) * u[0]
        maximum = p["max_speed"]
        speed = smooth.clip(
            state["speed"] + (fall + push) * p["step"], -maximum, maximum, scale=maximum
        )
        return {"angle": state["angle"] + speed * p["step"], "speed": speed}

    def cost(self, w, p, state, u):
        return {
            "angle": w["angle"] * wrap_angle(state["angle"]) ** 2,
            "speed": w["speed"] * state["speed"] ** 2,
            "torque": w["torque"] * u[0] ** 2,
        }

    def features(self, p, state):
        return jnp.append(angle_features(state["angle"]), state["speed"] / p["max_speed"])

    def recover(self, p, features):
        angle = jnp.arctan2(features[1], features[0])
        return {"angle": angle, "speed": features[2] * p["max_speed"]}

    def from_twin(self, p, observed):
        return observed / np.array([1.0, 1.0, p["max_speed"]])

    def proportional(self, p):
        # Twice the torque that holds the rod next to its rest; a tenth of it for the speed.
        hold = p["mass"] * p["gravity"] * p["length"]
        return {"angle": np.array([hold]), "speed": np.array([hold / 5])}
