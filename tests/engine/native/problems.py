"""Small simulators that use many corners of the native engine, and a comparison of trees."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.actions import Box
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator

TOLERANCE = {"float32": 1e-5, "float64": 1e-11}


class Store(Simulator):
    """A store of gas with a one-factor price: curves, limits, a table, a terminal and an initial."""

    horizon: int = eqx.field(static=True, default=9)
    action: Box = eqx.field(default=Box(0.0, 1.0, 2))
    noise_size: int = eqx.field(static=True, default=3)
    initial_noise_size: ClassVar[int] = 1

    def prepare(self, inputs):
        constants = {"reversion": jnp.array(0.3), "levels": jnp.array([0.0, 0.4, 1.0])}
        days = jnp.arange(self.horizon)
        steps = {
            "forward": 1.5 + 0.1 * jnp.sin(days),
            "rates": 0.2 + 0.01 * days[:, None] * jnp.ones(3),
        }
        return Schedule(constants, steps | {"day": days})

    def initial(self, constants, noise):
        return {"x": 0.1 * noise[0], "level": constants["reversion"] * 1.5, "count": jnp.array(0)}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"], state["level"], now["forward"], jnp.sin(now["forward"])])

    def step(self, constants, now, state, action, noise, smooth):
        x = state["x"] * jnp.exp(-constants["reversion"]) + 0.2 * noise[0] + 0.05 * noise[2]
        price = now["forward"] * jnp.exp(x + 0.1 * noise[1])
        rate = jnp.interp(state["level"], constants["levels"], now["rates"])
        up = smooth.minimum(action[0] * rate, 1 - state["level"], scale=0.1)
        down = smooth.minimum(action[1] * rate, state["level"], scale=0.1)
        count = state["count"] + (now["day"] % 2).astype(int)
        after = {"x": x, "level": state["level"] + up - down, "count": count}
        return after, {"cash": (down - up) * price, "peak": price, "left": after["level"]}

    def terminal(self, constants, state, smooth):
        return {"cash": state["level"] * jnp.tanh(state["x"]), "end": state["x"] * state["count"]}

    def totals(self):
        return {"peak": "max", "left": "last"}

    def state_scale(self, constants):
        return {"x": 0.5, "level": 1.0, "count": 1}

    def slack(self, constants, now, state, outputs):
        return {"room": 1 - state["level"]}


class Wide(Simulator):
    """Many factors with a correlation, a matrix-vector product per step, a wide state."""

    horizon: int = eqx.field(static=True, default=5)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))
    noise_size: int = eqx.field(static=True, default=30)

    def prepare(self, inputs):
        lower = jnp.tril(jnp.cos(jnp.arange(900.0).reshape(30, 30))) / 10
        steps = {"drift": jnp.linspace(0, 0.1, self.horizon), "tilt": jnp.ones((self.horizon, 30))}
        return Schedule({"lower": lower, "weights": jnp.linspace(0.5, 1.5, 30)}, steps)

    def initial(self, constants, noise):
        return {"factors": jnp.zeros(30), "history": jnp.zeros((4, 5))}

    def observe(self, constants, now, state):
        return jnp.concatenate([state["factors"][:20], state["history"].sum(0)])

    def step(self, constants, now, state, action, noise, smooth):
        moved = 0.9 * state["factors"] + constants["lower"] @ noise + now["drift"] * now["tilt"]
        value = jnp.dot(constants["weights"], jnp.tanh(moved)) * action[0]
        row = jnp.stack([value, moved[3], moved.max(), moved[::7].sum(), jnp.sum(moved**2)])
        history = jnp.concatenate([row[None], state["history"][:-1]])
        return {"factors": moved, "history": history}, {"value": value + history[3, 1]}


class Tanh(Policy):
    """A network in plain arrays."""

    weights: list
    biases: list

    def __init__(self, widths, seed: int = 0):
        rng = np.random.default_rng(seed)
        shapes = list(zip(widths[1:], widths[:-1]))
        self.weights = [
            jnp.asarray(rng.normal(size=s) / np.sqrt(s[1]), jnp.float32) for s in shapes
        ]
        self.biases = [jnp.asarray(0.1 * rng.normal(size=s[0]), jnp.float32) for s in shapes]

    def __call__(self, x, smooth):
        for weight, bias in zip(self.weights[:-1], self.biases[:-1]):
            x = jnp.tanh(weight @ x + bias)
        return jax.nn.sigmoid(self.weights[-1] @ x + self.biases[-1])


def difference(expected, found, least: float = 1e-30) -> float:
    """The largest difference between two trees, relative to the largest of each leaf, or `least`."""
    expected_leaves, expected_tree = jax.tree.flatten(expected)
    leaves, tree = jax.tree.flatten(found)
    assert tree == expected_tree
    worst = 0.0
    for a, b in zip(expected_leaves, leaves):
        a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
        assert a.shape == b.shape
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        if a.size:
            worst = max(worst, np.nanmax(np.abs(a - b)) / max(np.nanmax(np.abs(a)), least))
    return float(worst)
