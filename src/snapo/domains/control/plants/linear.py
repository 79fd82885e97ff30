"""A linear plant with a quadratic cost, whose matrices are in the case; its actions may have
bounds."""

import math

import numpy as np

from snapo.problem.actions import Box

from ..kinds import LinearQuadraticKind
from .plant import Plant


class LinearQuadratic(LinearQuadraticKind, Plant):
    """x' = A x + B u + G z with z standard normal; the cost is x'Q x + u'R u in every step and
    x'Q_T x at the end. Without `limit` the best rule is linear, and its value and derivatives have
    a closed form: see `regulator.py`. With `limit`, every action lies between -limit and limit.
    """

    def decisions(self, inputs):
        size = inputs["plant"]["B"].value.shape[1]
        high = 1.0 if "limit" in inputs["plant"] else math.inf
        return Box(-high, high, size)

    def drive(self, p, action):
        return p["limit"] * action if "limit" in p else action

    def move(self, p, state, u, smooth):
        return {"x": p["A"] @ state["x"] + p["B"] @ u}

    def cost(self, w, p, state, u):
        return {"state": state["x"] @ (w["Q"] @ state["x"]), "action": u @ (w["R"] @ u)}

    def final_cost(self, w, p, state):
        return {"state": state["x"] @ (w["Q_T"] @ state["x"])}

    def features(self, p, state):
        return state["x"]

    def recover(self, p, features):
        return {"x": features[: np.shape(p["A"])[0]]}
