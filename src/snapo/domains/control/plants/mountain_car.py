"""Gymnasium's MountainCarContinuous-v0: an engine too weak for the hill, and a prize on top."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from snapo.problem.policy import Threshold

from .plant import Parameter, Plant, Quantity, outputs

BOTTOM = -np.pi / 6  # of the valley
WIDTH = 10.0  # of the smooth goal: times the temperature, in the units of the position


class MountainCar(Plant):
    """A car in a valley; at the goal the episode ends with a prize (Gymnasium 1.4).

    speed' = clip(speed + power a - gravity cos(3 position)), position' = clip(position + speed'),
    speed' = 0 where it runs into the left wall. A step costs 0.1 a^2 while the car is on its way.

    In training the goal is a slope: each step reaches it with a probability that rises with the
    position and narrows with the temperature, and `alive` is the probability to be still on the
    way. The exact reward holds no hint of the goal's direction; this one does.
    """

    type: ClassVar = "mountain-car"
    words: ClassVar = "MountainCarContinuous-v0: swing a weak car up a hill"
    steps: ClassVar = 999
    twin: ClassVar = "MountainCarContinuous-v0"
    rests: ClassVar = False
    parameters: ClassVar = {
        "power": Parameter(0.0015, "1/step2", "acceleration of the engine at full power"),
        "gravity": Parameter(0.0025, "1/step2", "steepest pull of the hill"),
        "max_speed": Parameter(0.07, "1/step", "largest speed"),
        "left": Parameter(-1.2, "1", "place of the left wall", False),
        "right": Parameter(0.6, "1", "place of the right wall", False),
        "goal": Parameter(0.45, "1", "place of the goal", False),
    }
    weights: ClassVar = {
        "prize": Parameter(100.0, "1", "prize at the goal", False),
        "effort": Parameter(0.1, "1", "weight of the squared action", False),
    }
    states: ClassVar = {
        "position": Quantity("1", "position", {"low": -0.6, "high": -0.4}),
        "speed": Quantity("1/step", "speed", {"at": 0.0}),
    }
    actions: ClassVar = {"action": Quantity("1", "share of the engine's power")}

    @classmethod
    def faults(cls, values):
        yield from super().faults(values)
        plant = values["plant"]
        if not plant["left"] < BOTTOM < plant["goal"] <= plant["right"]:
            what = f"allowed is left < {BOTTOM:.3f} (the bottom of the valley) < goal <= right"
            yield "plant.goal", float(plant["goal"]), what

    def initial(self, constants, noise):
        return super().initial(constants, noise) | {"alive": jnp.ones((), noise.dtype)}

    def drive(self, p, action):
        return action

    def move(self, p, state, u, smooth):
        most = p["max_speed"]
        pull = p["gravity"] * jnp.cos(3 * state["position"])
        speed = smooth.clip(state["speed"] + u[0] * p["power"] - pull, -most, most, scale=most)
        position = jnp.clip(state["position"] + speed, p["left"], p["right"])
        stopped = (position <= p["left"]) & (speed < 0)
        return {"position": position, "speed": jnp.where(stopped, 0.0, speed)}

    def cost(self, w, p, state, u):
        return {"effort": w["effort"] * u[0] ** 2}

    def step(self, constants, now, state, action, noise, smooth):
        p, w, alive = constants["plant"], constants["cost"], state["alive"]
        effort = alive * self.cost(w, p, state, action)["effort"]
        after = self.disturbed(now, self.move(p, state, action, smooth), noise)
        there = smooth.indicator(after["position"] - p["goal"], WIDTH)
        there = there * jnp.where(after["speed"] < 0, 0.0, 1.0)
        prize = w["prize"] * alive * there
        after["alive"] = alive * (1 - there)
        return after, {**outputs({"effort": effort}), "reward": prize - effort, "prize": prize}

    def over(self, constants, state):
        """Whether the episode has ended in this state."""
        return state["alive"] < 0.5

    def features(self, p, state):
        return jnp.stack([(state["position"] - BOTTOM) / 0.6, state["speed"] / p["max_speed"]])

    def recover(self, p, features):
        speed = features[1] * p["max_speed"]
        return {"position": features[0] * 0.6 + BOTTOM, "speed": speed}

    def from_twin(self, p, seen):
        return (seen - np.array([BOTTOM, 0.0])) / np.array([0.6, p["max_speed"]])

    def hand_rules(self, p):
        push = [jnp.full(1, -1.0), jnp.full(1, 1.0)]
        return {"full power with the speed": Threshold(jnp.zeros(()), *push, feature=1)}
