"""Gymnasium's MountainCarContinuous-v0: an engine too weak for the hill, and a prize on top."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.rules import Threshold
from snapo.problem.smooth import Exact

from .plant import Plant, PlantParameter, Variable, outputs

BOTTOM = -np.pi / 6  # of the valley
AIM = 1.15  # energy where a training step ends the way with probability 1/2; the goal takes 1
WIDTH = 10.0  # of the smooth goal: times the temperature, as a share of the energy it takes


class MountainCar(Plant):
    """A car in a valley; at the goal the episode ends with a prize (Gymnasium 1.4).

    speed' = clip(speed + power a - gravity cos(3 position)), position' = clip(position + speed'),
    speed' = 0 where it runs into the left wall. A step costs 0.1 a^2 until the car arrives.

    The exact reward gives no hint of the goal. In training the goal counts as reached by energy:
    each step ends the episode with a probability that is 1/2 where the energy, v^2 / 2 + gravity
    sin(3 x) / 3, slightly exceeds the energy needed for the hill, and falls off below over a width
    set by the temperature; `alive` is the probability of not having arrived. With this energy the
    next swing arrives.
    """

    type: ClassVar = "mountain-car"
    description: ClassVar = "MountainCarContinuous-v0: swing a weak car up a hill"
    steps: ClassVar = 999
    twin: ClassVar = "MountainCarContinuous-v0"
    rests: ClassVar = False
    parameters: ClassVar = {
        "power": PlantParameter(0.0015, "1/step2", "acceleration of the engine at full power"),
        "gravity": PlantParameter(0.0025, "1/step2", "steepest pull of the hill"),
        "max_speed": PlantParameter(0.07, "1/step", "largest speed"),
        "left": PlantParameter(-1.2, "1", "position of the left wall", False),
        "right": PlantParameter(0.6, "1", "position of the right wall", False),
        "goal": PlantParameter(0.45, "1", "place of the goal", False),
    }
    weights: ClassVar = {
        "prize": PlantParameter(100.0, "1", "prize at the goal", False),
        "effort": PlantParameter(0.1, "1", "weight of the squared action", False),
    }
    states: ClassVar = {
        "position": Variable("1", "position", {"low": -0.6, "high": -0.4}),
        "speed": Variable("1/step", "speed", {"at": 0.0}),
    }
    actions: ClassVar = {"action": Variable("1", "share of the engine's power")}

    @classmethod
    def faults(cls, values):
        yield from super().faults(values)
        plant = values["plant"]
        if not plant["left"] < BOTTOM < plant["goal"] <= plant["right"]:
            message = f"it must be left < {BOTTOM:.3f} (the bottom of the valley) < goal <= right"
            yield "plant.goal", float(plant["goal"]), message

    def initial(self, constants, noise):
        return super().initial(constants, noise) | {"alive": jnp.ones((), noise.dtype)}

    def drive(self, p, action):
        return action

    def move(self, p, state, u, smooth):
        maximum = p["max_speed"]
        pull = p["gravity"] * jnp.cos(3 * state["position"])
        speed = smooth.clip(
            state["speed"] + u[0] * p["power"] - pull, -maximum, maximum, scale=maximum
        )
        position = jnp.clip(state["position"] + speed, p["left"], p["right"])
        stopped = (position <= p["left"]) & (speed < 0)
        return {"position": position, "speed": jnp.where(stopped, 0.0, speed)}

    def cost(self, w, p, state, u):
        return {"effort": w["effort"] * u[0] ** 2}

    def step(self, constants, now, state, action, noise, smooth):
        p, w, alive = constants["plant"], constants["cost"], state["alive"]
        effort = alive * self.cost(w, p, state, action)["effort"]
        after = self.disturbed(now, self.move(p, state, action, smooth), noise)
        if isinstance(smooth, Exact):
            there = jnp.where((after["position"] >= p["goal"]) & (after["speed"] >= 0), 1.0, 0.0)
        else:
            there = smooth.indicator(energy(p, after) - AIM, WIDTH)
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

    def from_twin(self, p, observed):
        return (observed - np.array([BOTTOM, 0.0])) / np.array([0.6, p["max_speed"]])

    def hand_rules(self, p):
        push = [jnp.full(1, -1.0), jnp.full(1, 1.0)]
        return {"full power with the speed": Threshold(jnp.zeros(()), *push, feature=1)}


def energy(p, state):
    """Energy above that at rest in the valley, as a share of the energy needed for the goal."""
    high = (jnp.sin(3 * p["goal"]) + 1) * p["gravity"] / 3
    lifted = (jnp.sin(3 * state["position"]) + 1) * p["gravity"] / 3
    return (state["speed"] ** 2 / 2 + lifted) / high
