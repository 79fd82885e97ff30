"""A linear plant with a quadratic cost, its matrices in the case; its actions may have bounds."""

import math
from typing import ClassVar

import numpy as np

from snapo.problem.actions import Box

from .plant import Plant, PlantParameter, Variable


class LinearQuadratic(Plant):
    """x' = A x + B u + G z with z standard normal; a step costs x'Q x + u'R u, the end x'Q_T x.

    Without `limit` the best rule is linear, and value and derivatives are known in closed form:
    see `regulator.py`. With it, every action lies between -limit and limit.
    """

    type: ClassVar = "linear-quadratic"
    description: ClassVar = "a linear plant with a quadratic cost, with or without bounds"
    steps: ClassVar = 20
    sees_time: ClassVar = True
    parameters: ClassVar = {
        "A": PlantParameter(None, "1", "from state to state", False),
        "B": PlantParameter(None, "1", "from action to state", False),
        "limit": PlantParameter(math.inf, "1", "largest size of an action"),
    }
    weights: ClassVar = {
        "Q": PlantParameter(None, "1", "weights of the state", False),
        "R": PlantParameter(None, "1", "weights of the action", False),
        "Q_T": PlantParameter(None, "1", "weights of the last state", False),
    }
    states: ClassVar = {"x": Variable("1", "state")}
    actions: ClassVar = {"u": Variable("1", "action")}

    @classmethod
    def faults(cls, values):
        plant, cost = values["plant"], values["cost"]
        size = plant["A"].shape[0]
        actions = plant["B"].shape[-1]
        shapes = {
            "plant.A": (plant["A"], (size, size)), "plant.B": (plant["B"], (size, actions)),
            "cost.Q": (cost["Q"], (size, size)), "cost.Q_T": (cost["Q_T"], (size, size)),
            "cost.R": (cost["R"], (actions, actions)),
        }  # fmt: skip
        for key, (inputs, shape) in shapes.items():
            if inputs.shape != shape:
                message = f"it must be {shape[0]} rows of {shape[1]} numbers"
                yield key, inputs.tolist(), message
        for key in ("Q", "Q_T", "R"):
            inputs, minimum = cost[key], 1e-12 if key == "R" else -1e-9
            message = "it must be a symmetric matrix without negative eigenvalues"
            message = (
                "it must be a symmetric matrix with eigenvalues above 0" if key == "R" else message
            )
            if not np.allclose(inputs, inputs.T) or np.linalg.eigvalsh(inputs).min() < minimum:
                yield f"cost.{key}", inputs.tolist(), message
        for key, inputs in values["start"]["x"].items():
            if inputs.shape != (size,):
                yield f"start.x.{key}", inputs.tolist(), f"it must be {size} numbers"
        for inputs in values["noise"].values():
            if inputs.shape != (size, size):
                message = f"it must be {size} numbers, or {size} rows of {size}"
                yield "noise.x", inputs.tolist(), message

        for inputs in values["measurement"].values():
            if inputs.shape != (size,):
                yield "measurement.x", inputs.tolist(), f"it must be {size} numbers"

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
