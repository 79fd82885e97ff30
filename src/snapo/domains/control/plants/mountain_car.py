"""Gymnasium's MountainCarContinuous-v0: an engine too weak for the hill, and a prize on top."""

import jax.numpy as jnp
import numpy as np

from snapo.problem.policies.rules import Threshold
from snapo.problem.smooth import Exact

from ..kinds import BOTTOM, MountainCarKind
from .plant import Plant, outputs

AIM = 1.15  # energy where a training step ends the way with probability 1/2; the goal takes 1
WIDTH = 10.0  # of the smooth goal: times the temperature, as a share of the energy it takes


class MountainCar(MountainCarKind, Plant):
    """A car in a valley; at the goal the episode ends with a reward (Gymnasium 1.4).

    speed' = clip(speed + power a - gravity cos(3 position)), position' = clip(position + speed'),
    speed' = 0 if it runs into the left wall. A step costs 0.1 a^2 until the car arrives.

    The exact reward gives no hint of the goal. In training, the energy v^2 / 2 + gravity sin(3 x) /
    3 decides whether the goal is reached, because a car with the energy needed for the hill reaches
    the goal in the next swing. Each step ends the episode with a probability that rises with the
    energy, over a width that the temperature determines. It is 1/2 at an energy slightly above the
    energy needed. `alive` is the probability that the car has not arrived.
    """

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

    def unmeasured(self, constants, now, state, action, noise, smooth):
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
        return {
            "full power in the direction of the speed": Threshold(jnp.zeros(()), *push, feature=1)
        }


def energy(p, state):
    """The energy above the energy at rest in the valley, as a share of the energy needed for the
    goal."""
    high = (jnp.sin(3 * p["goal"]) + 1) * p["gravity"] / 3
    lifted = (jnp.sin(3 * state["position"]) + 1) * p["gravity"] / 3
    return (state["speed"] ** 2 / 2 + lifted) / high
