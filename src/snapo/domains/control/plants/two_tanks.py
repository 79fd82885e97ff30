"""Two tanks one below the other, fed by a pump: hold the level of the lower one."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from .plant import Plant, PlantParameter, Variable, runge_kutta

MINIMUM = 1e-3  # of the height: below it the outflow falls linearly to 0, as the root's slope grows


class TwoTanks(Plant):
    """Levels h of water, outflow c sqrt(2 g h) (Torricelli); the pump feeds the upper tank.

    area h1' = flow - c1 sqrt(2 g h1), area h2' = c1 sqrt(2 g h1) - c2 sqrt(2 g h2); Runge-Kutta of
    order 4, then levels between 0 and `height`: the excess spills. The cost of a step is the
    squared distance of the lower level from its target, plus the pump's squared share.
    """

    type: ClassVar = "two-tanks"
    description: ClassVar = "two tanks and a pump that controls a level"
    steps: ClassVar = 60
    parameters: ClassVar = {
        "area": PlantParameter(15.0, "cm2", "cross section of a tank"),
        "upper": PlantParameter(0.18, "cm2", "outlet of the upper tank"),
        "lower": PlantParameter(0.18, "cm2", "outlet of the lower tank"),
        "gravity": PlantParameter(981.0, "cm/s2", "gravity"),
        "flow": PlantParameter(40.0, "cm3/s", "largest flow of the pump"),
        "height": PlantParameter(30.0, "cm", "height of a tank"),
        "target": PlantParameter(15.0, "cm", "target level in the lower tank"),
        "step": PlantParameter(2.0, "s", "time step"),
    }
    weights: ClassVar = {
        "level": PlantParameter(0.01, "1/cm2", "weight of the squared distance to the level",
                          False),
        "pump": PlantParameter(0.02, "1", "weight of the squared change of the pump from its rest",
                          False),
    }  # fmt: skip
    states: ClassVar = {
        "upper": Variable("cm", "level of the upper tank", {"low": 2.0, "high": 20.0}),
        "lower": Variable("cm", "level of the lower tank", {"low": 2.0, "high": 20.0}),
    }
    actions: ClassVar = {"pump": Variable("cm3/s", "flow of the pump")}

    @classmethod
    def faults(cls, values):
        yield from super().faults(values)
        plant = values["plant"]
        ratio = float(plant["lower"] / plant["upper"])
        maximum = float(plant["height"]) / max(1.0, ratio**2)
        if plant["target"] > maximum:
            message = f"it must be at most {maximum:.4g}: no tank may overflow while it is held"
            yield "plant.target", float(plant["target"]), message
        holding = float(_holding(plant, np))
        if holding > plant["flow"]:
            message = f"it must be at least {holding:.4g}, which holds the target"
            yield "plant.flow", float(plant["flow"]), message

    def drive(self, p, action):
        return p["flow"] * (action + 1) / 2

    def move(self, p, state, u, smooth):
        after = runge_kutta(lambda at: slopes(p, at, u[0]), state, p["step"])
        top = p["height"]
        return {name: smooth.clip(h, 0.0, top, scale=top) for name, h in after.items()}

    def cost(self, w, p, state, u):
        away = (u[0] - _holding(p, jnp)) / p["flow"]
        return {
            "level": w["level"] * (state["lower"] - p["target"]) ** 2,
            "pump": w["pump"] * away**2,
        }

    def features(self, p, state):
        return jnp.stack([state["upper"], state["lower"]]) / p["target"] - 1

    def recover(self, p, features):
        levels = (features[:2] + 1) * p["target"]
        return {"upper": levels[0], "lower": levels[1]}

    def target_at(self, p):
        requested = float(p["target"])
        ratio = float(p["lower"]) / float(p["upper"])
        return {"upper": np.array(requested * ratio**2), "lower": np.array(requested)}

    def rest(self, p):
        return np.array([float(_holding(p, np))])

    def proportional(self, p):
        return {"lower": np.array([0.1 * float(p["flow"])])}


def _holding(p, xp):
    """The flow that holds the lower level at its target."""
    return p["lower"] * xp.sqrt(2 * p["gravity"] * p["target"])


def slopes(p, at, flow):
    """The time derivatives of the levels."""
    minimum = MINIMUM * p["height"]

    def out(opening, level):
        root = jnp.sqrt(2 * p["gravity"] * jnp.maximum(level, minimum))
        return opening * root * jnp.clip(level / minimum, 0.0, 1.0)

    between = out(p["upper"], at["upper"])
    away = out(p["lower"], at["lower"])
    return {"upper": (flow - between) / p["area"], "lower": (between - away) / p["area"]}
