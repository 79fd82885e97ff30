"""Two tanks, one below the other, fed by a pump: hold the level of the lower tank."""

import jax.numpy as jnp
import numpy as np

from snapo.problem.record.either import with_numpy

from ..kinds import TwoTanksKind, holding_flow
from .plant import Plant, runge_kutta

MINIMUM = 1e-3  # of the height: below it the outflow falls linearly to 0, as the root's slope grows


class TwoTanks(TwoTanksKind, Plant):
    """Levels h of water, outflow c sqrt(2 g h) (Torricelli); the pump feeds the upper tank.

    area h1' = flow - c1 sqrt(2 g h1), area h2' = c1 sqrt(2 g h1) - c2 sqrt(2 g h2); Runge-Kutta of
    order 4, then levels between 0 and `height`: the excess spills. The cost of a step has two
    squares, each with its weight: the distance of the lower level from its target, and the change
    of the pump's flow from its flow at rest, as a share of its largest flow.
    """

    def drive(self, p, action):
        return p["flow"] * (action + 1) / 2

    def move(self, p, state, u, smooth):
        after = runge_kutta(lambda at: slopes(p, at, u[0]), state, p["step"])
        top = p["height"]
        return {name: smooth.clip(h, 0.0, top, scale=top) for name, h in after.items()}

    def cost(self, w, p, state, u):
        away = (u[0] - holding_flow(p)) / p["flow"]
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
        return np.array([float(with_numpy(holding_flow)(p))])

    def proportional(self, p):
        return {"lower": np.array([0.1 * float(p["flow"])])}


def slopes(p, at, flow):
    """The time derivatives of the levels."""
    minimum = MINIMUM * p["height"]

    def out(opening, level):
        root = jnp.sqrt(2 * p["gravity"] * jnp.maximum(level, minimum))
        return opening * root * jnp.clip(level / minimum, 0.0, 1.0)

    between = out(p["upper"], at["upper"])
    away = out(p["lower"], at["lower"])
    return {"upper": (flow - between) / p["area"], "lower": (between - away) / p["area"]}
