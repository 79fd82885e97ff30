"""PI controllers, and cascades of them, as a policy: a baseline for the trained policy.

A loop moves its control around the recipe: v = recipe + K e + I, e = setpoint - reading, at every
decision. Its integral moves by dt / Ti (K e + applied - v): the part removed by limits and ramps is
reset with the time Ti, so that it does not wind up (Astrom and Hagglund 2006, section 3.5). In a
cascade the outer loop's v is the setpoint of the inner one.

Gains and times are trained numbers, like the recipe: the same adjoint tunes them.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.inputs import Frozen
from snapo.problem.policies.memory import Memory

from .policy import EDGE


class LoopConnection(NamedTuple):
    """The connection of one PI controller. An outer loop comes before its inner loop.

    - `first`, `count`: its decisions; `seconds` between them. `sensor`, `control`: indices of the
      features that have its reading and the applied value of its control; `position`: the index of
      this control in the action.
    - `inner`: number of the loop whose setpoint it moves, from `low` to `high` in the reading of
      that loop; -1: it moves the control itself, from 0 to 1.
    """

    first: int
    count: int
    seconds: float
    sensor: int
    control: int
    position: int
    inner: int
    low: float
    high: float


class Loops(Memory):
    """A recipe, [T, size] logits, and PI controllers about it.

    - `log_gain` [L]: the logarithm of the size of each gain, in shares of the control's range (or
      readings of the inner sensor) per reading; minus infinity for an open loop.
    - `log_time` [L]: the logarithm of each integral time in s. `signs` [L]: the signs of the gains,
      not trained.
    - `setpoints` [L, T] for the readings.
    """

    table: Float[Array, "T size"]
    log_gain: Float[Array, " L"]
    log_time: Float[Array, " L"]
    signs: Frozen
    setpoints: Frozen
    connections: tuple[LoopConnection, ...] = eqx.field(static=True)

    def __init__(
        self, table: np.ndarray, connections: tuple[LoopConnection, ...], setpoints: np.ndarray
    ):
        """All loops are open at first."""
        self.table = jnp.asarray(table, jnp.float32)
        self.log_gain = jnp.full(len(connections), -jnp.inf, jnp.float32)
        self.log_time = jnp.zeros(len(connections), jnp.float32)
        self.signs = Frozen(np.ones(len(connections), np.float32))
        self.setpoints = Frozen(np.asarray(setpoints, np.float32))
        self.connections = connections

    @property
    def memory(self) -> int:
        return len(self.connections)

    def decide(self, observation, memory, smooth):
        kind = observation.dtype
        count, size = self.table.shape
        timer = observation[0] * count
        weights = jnp.maximum(1 - jnp.abs(timer - jnp.arange(count)), 0).astype(kind)
        planned = jax.nn.sigmoid(weights @ self.table.astype(kind))
        requested = jnp.asarray(self.setpoints).astype(kind) @ weights
        gains = jnp.asarray(self.signs).astype(kind) * jnp.exp(self.log_gain.astype(kind))
        times = jnp.exp(self.log_time.astype(kind))
        correction, selected = jnp.zeros(size, kind), []
        for i, connection in enumerate(self.connections):
            now = (timer > connection.first - 0.5) & (
                timer < connection.first + connection.count - 0.5
            )
            later = now & (timer > connection.first + 0.5)
            pace = jnp.minimum(connection.seconds / times[i], 1.0)
            direct = connection.inner < 0
            # What was applied of the last decision is seen only now.
            applied = pace * observation[connection.control] if direct else 0.0
            integral = jnp.where(later, memory[i] + applied, 0.0)
            error = gains[i] * (requested[i] - observation[connection.sensor])
            base = planned[connection.position] if direct else requested[connection.inner]
            moved = base + error + integral
            if direct:
                after = pace * (error - moved)
                correction = correction.at[connection.position].add(
                    jnp.where(now, error + integral, 0.0)
                )
            else:
                width = connection.high - connection.low
                held = smooth.clip(moved, connection.low, connection.high, scale=width)
                after = pace * (error + held - moved)
                requested = requested.at[connection.inner].set(
                    jnp.where(now, held, requested[connection.inner])
                )
            selected.append(jnp.where(now, integral + after, 0.0))
        action = Box(0.0, 1.0, size).near(planned, correction, smooth)
        return action, jnp.stack(selected).astype(kind)

    def on(self, recipe: np.ndarray) -> "Loops":
        """The same loops around another recipe, [T, size] actions in 0..1."""
        inside = np.clip(recipe, EDGE, 1 - EDGE)
        table = jnp.asarray(np.log(inside / (1 - inside)), jnp.float32)
        return eqx.tree_at(lambda policy: policy.table, self, table)

    def tuned(self, number: int, gain: float, time: float) -> "Loops":
        """The same loops, but one of them with this gain and this integral time in s."""
        signs = np.array(self.signs.array)
        signs[number] = np.sign(gain)
        return eqx.tree_at(
            lambda policy: (policy.log_gain, policy.log_time, policy.signs),
            self,
            (
                self.log_gain.at[number].set(np.log(abs(gain))),
                self.log_time.at[number].set(np.log(time)),
                Frozen(signs),
            ),
        )

    def with_setpoints(self, setpoints: np.ndarray) -> "Loops":
        """The same loops with other setpoints, [L, T]."""
        frozen = Frozen(np.asarray(setpoints, np.float32))
        return eqx.tree_at(lambda policy: policy.setpoints, self, frozen)

    def gains(self) -> np.ndarray:
        """[L] gains with their signs, in shares of the control's range per reading."""
        return np.asarray(self.signs.array) * np.exp(np.asarray(self.log_gain, float))

    def times(self) -> np.ndarray:
        """[L] integral times in s."""
        return np.exp(np.asarray(self.log_time, float))
