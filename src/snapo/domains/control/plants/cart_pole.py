"""Cart and pole: swing the pole up from hanging, and hold it there."""

import jax.numpy as jnp

from snapo.problem.angle import angle_features

from ..kinds import CartPoleKind
from .plant import Plant, runge_kutta


class CartPole(CartPoleKind, Plant):
    """A uniform rod of length l and mass m on a cart of mass M, pushed by a force u.

    With the angle a from upright and h = m l / 2,
    (M + m) x'' + h (a'' cos a - a'^2 sin a) = u - friction x',
    (m l^2 / 3) a'' + h x'' cos a = h g sin a;
    one Runge-Kutta step of order 4. Masses and limits are those of Deisenroth and
    Rasmussen, PILCO (2011). A step costs position^2 + angle 2 (1 - cos a) + speed^2 + spin^2 +
    force^2, each with its weight.
    """

    def drive(self, p, action):
        return p["force"] * action

    def move(self, p, state, u, smooth):
        return runge_kutta(lambda at: slopes(p, at, u[0]), state, p["step"])

    def cost(self, w, p, state, u):
        return {
            "position": w["position"] * state["position"] ** 2,
            "angle": w["angle"] * 2 * (1 - jnp.cos(state["angle"])),
            "speed": w["speed"] * state["speed"] ** 2,
            "spin": w["spin"] * state["spin"] ** 2,
            "force": w["force"] * u[0] ** 2,
        }

    def features(self, p, state):
        position = jnp.stack([state["position"], state["speed"] / 2])
        return jnp.concatenate([position, angle_features(state["angle"]), state["spin"][None] / 5])

    def recover(self, p, features):
        x, v, cosine, sine, spin = features[:5]
        angle = jnp.arctan2(sine, cosine)
        return {"position": x, "angle": angle, "speed": 2 * v, "spin": 5 * spin}


def slopes(p, at, force):
    """The time derivatives of all states."""
    sine, cosine, mass = jnp.sin(at["angle"]), jnp.cos(at["angle"]), p["pole"]
    lever, inertia = mass * p["length"] / 2, mass * p["length"] ** 2 / 3
    total, turn = p["cart"] + mass, lever * p["gravity"] * sine
    push = force - p["friction"] * at["speed"] + lever * at["spin"] ** 2 * sine
    determinant = total * inertia - (lever * cosine) ** 2
    return {
        "position": at["speed"],
        "angle": at["spin"],
        "speed": (inertia * push - lever * cosine * turn) / determinant,
        "spin": (total * turn - lever * cosine * push) / determinant,
    }
