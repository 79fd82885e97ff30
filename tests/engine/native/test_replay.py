"""Recorded actions replayed: the same bits as the run that recorded them, in every kernel."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh, Wide

from snapo.engine.native import Native
from snapo.problem.actions import Box
from snapo.problem.policy import Policy
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

PATHS = 64


class Pendulum(Simulator):
    """Swings chaotically: a difference in the last place grows to one that everybody sees."""

    horizon: int = eqx.field(static=True, default=200)
    action: Box = eqx.field(default=Box(-2.0, 2.0))
    noise_size: int = eqx.field(static=True, default=1)
    initial_noise_size: int = eqx.field(static=True, default=2)

    def prepare(self, inputs):
        return Schedule({"m": jnp.array(1.0), "l": jnp.array(1.0), "g": jnp.array(10.0)}, {})

    def initial(self, constants, noise):
        return {"angle": jnp.pi * jnp.tanh(noise[0]), "speed": 0.5 * noise[1]}

    def observe(self, constants, now, state):
        return jnp.stack([jnp.cos(state["angle"]), jnp.sin(state["angle"]), state["speed"]])

    def step(self, constants, now, state, action, noise, smooth):
        angle, speed, torque = state["angle"], state["speed"], action[0]
        turned = jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi
        cost = turned**2 + 0.1 * speed**2 + 0.001 * torque**2 + jnp.abs(2 * torque - 0.1) / 3
        fall = 1.5 * constants["g"] / constants["l"] * jnp.sin(angle)
        push = 3.0 / (constants["m"] * constants["l"] ** 2) * torque
        speed = jnp.clip(speed + (fall + push) * 0.05 + 0.01 * noise[0], -8, 8)
        return {"angle": angle + speed * 0.05, "speed": speed}, {"reward": -cost}


class Wheel(Tanh):
    """A network whose last operation is a product and a sum."""

    def __call__(self, x, smooth):
        return 4 * super().__call__(x, smooth) - 2


class Held(Policy):
    """The same torque always: known before the first path, or even while compiling."""

    torque: Any

    def __call__(self, x, smooth):
        return jnp.stack([jnp.asarray(self.torque)]) * 1.7


CASES = {
    "network": (Pendulum(), Wheel((3, 16, 1))),
    "parameter": (Pendulum(horizon=20), Held(jnp.array(0.3))),
    "constant": (Pendulum(horizon=20), Held(0.3)),
    "limits": (Store(), Tanh((4, 14, 2))),
    "many factors": (Wide(), Tanh((25, 8, 1))),
}


QUICK = [("network", "float64"), ("constant", "float32")]
REST = [(case, p) for case in CASES for p in ("float32", "float64") if (case, p) not in QUICK]


@pytest.mark.parametrize(
    "case, precision", [*QUICK, *(pytest.param(*each, marks=pytest.mark.prove) for each in REST)]
)
def test_recorded_actions_give_the_same_bits(case, precision):
    """Values with and without records, values and adjoints of recorded actions."""
    simulator, policy = CASES[case]
    native, exact = Native(precision), Exact()
    draws = Pseudo(0).draws(np.arange(PATHS), simulator)
    with native.numbers():
        schedule = simulator.prepare(None)

    def totals(found):
        return {name: np.asarray(total).tobytes() for name, total in found.totals.items()}

    run = native.values(simulator, policy, schedule, draws, exact, record=("action",))
    actions = run.record["action"]
    weights = {name: np.ones(PATHS) for name in run.totals}
    for again in (
        native.values(simulator, policy, schedule, draws, exact),
        native.values(simulator, None, schedule, draws, exact, actions=actions),
        native.adjoint(simulator, policy, schedule, draws, exact, weights),
        native.adjoint(simulator, None, schedule, draws, exact, weights, actions=actions),
    ):
        assert totals(again) == totals(run)
