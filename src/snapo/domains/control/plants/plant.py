"""The base class of all plants: the equations of one step, and a cost that is a sum of parts.

A plant is a `Simulator` whose states have names. Its parameters, the weights of its cost, the
distribution of its initial state and its disturbances are inputs, so that each has a sensitivity.
"""

import abc
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Actions, Box
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator

from ..kinds import MEASURED, PlantKind, PlantValues, any_of

PlantState = dict[str, Array]


class Plant(PlantKind, Simulator):
    """One path of a controlled plant. A subclass contains the equations, and has the description of
    its kind as another base class.

    **Attributes:**

    - `horizon`: number of steps; `time_feature`: whether the policy sees the share of the horizon
      that is left.
    - `starts`: ((state, keys of its distribution), …) for all states.
    - `disturbed_parts`: the states with a disturbance; `shapes`: pairs (state, its shape).
    - `measured`: the states that are observed with measurement noise; the other states are observed
      exactly.
    """

    horizon: int = eqx.field(static=True)
    time_feature: bool = eqx.field(static=True)
    starts: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True)
    disturbed_parts: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = eqx.field(static=True)
    measured: tuple[str, ...] = eqx.field(static=True)
    action: Actions

    def __init__(
        self,
        inputs: Mapping[str, PlantValues],
        horizon: int | None = None,
        timer: bool | None = None,
    ):
        """Makes the plant for `inputs` (see `inputs.py`), of which it uses only shapes and keys."""
        self.horizon = self.steps if horizon is None else horizon
        self.time_feature = self.sees_time if timer is None else timer
        self.starts = tuple((name, tuple(inputs["start"][name])) for name in self.states)
        self.disturbed_parts = tuple(name for name in self.states if name in inputs["noise"])
        self.shapes = tuple((name, np.shape(any_of(inputs["start"][name]))) for name in self.states)
        self.measured = tuple(name for name in self.states if name in inputs.get(MEASURED, {}))
        self.action = self.decisions(inputs)

    def decisions(self, inputs: Mapping[str, PlantValues]) -> Actions:
        """The set of actions; an action is a share of its limit, from -1 to 1."""
        return Box(-1.0, 1.0, len(self.actions))

    @property
    def sizes(self) -> dict[str, int]:
        """{state: the count of its numbers}."""
        return {name: math.prod(shape) for name, shape in self.shapes}

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return sum(self.sizes[name] for name in (*self.disturbed_parts, *self.measured))

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        sizes = self.sizes
        drawn = sum(sizes[name] for name, keys in self.starts if len(keys) > 1)
        return drawn + sum(sizes[name] for name in self.measured)

    @abc.abstractmethod
    def drive(self, p: PlantValues, action: Any) -> Any:
        """The physical action [m] for a decision [m] in the set."""

    @abc.abstractmethod
    def move(self, p: PlantValues, state: PlantState, u: Float[Array, " m"], smooth) -> PlantState:
        """The state after one step, without disturbances."""

    @abc.abstractmethod
    def cost(
        self, w: PlantValues, p: PlantValues, state: PlantState, u: Float[Array, " m"]
    ) -> PlantState:
        """The parts of the cost of a step, which depends on the state before the step."""

    def final_cost(self, w: PlantValues, p: PlantValues, state: PlantState) -> PlantState:
        """The parts of the cost of the terminal state."""
        return {}

    @abc.abstractmethod
    def features(self, p: PlantValues, state: PlantState) -> Float[Array, " features"]:
        """The observation, of order one, without the clock."""

    @abc.abstractmethod
    def recover(self, p: PlantValues, features: Float[Array, " features"]) -> PlantState:
        """The state that belongs to an observation; angles are between -pi and pi."""

    def target_at(self, p: PlantValues) -> dict[str, np.ndarray]:
        """The state at which the plant should rest, by default 0."""
        return {name: np.zeros(shape) for name, shape in self.shapes}

    def rest(self, p: PlantValues) -> np.ndarray:
        """[m] the physical action that holds the plant at its target."""
        return np.zeros(self.action.size)

    def proportional(self, p: PlantValues) -> dict[str, np.ndarray]:
        """{state: [m] gains} of a classical controller u = rest - gains x (state - target)."""
        return {}

    def hand_rules(self, p: PlantValues) -> dict[str, Policy]:
        """Classical rules for only this plant, by name."""
        return {}

    def from_twin(self, p: PlantValues, observed: np.ndarray) -> np.ndarray:
        """[N, features] from the environment's observations [N, k]."""
        raise NotImplementedError(f"{self.type} has no counterpart in Gymnasium.")

    def to_twin(self, p: PlantValues, action: np.ndarray) -> np.ndarray:
        """[N, m] the environment's actions from decisions."""
        return np.asarray(self.drive(p, action), np.float32)

    def prepare(self, inputs: Mapping[str, PlantValues]) -> Schedule:
        constants = {key: dict(inputs[key]) for key in ("plant", "cost", "start")}
        if self.measured:
            constants[MEASURED] = dict(inputs[MEASURED])
        steps: dict[str, Any] = {"left": 1 - jnp.arange(self.horizon) / self.horizon}
        for name in self.disturbed_parts:
            values = jnp.asarray(inputs["noise"][name])
            # With three axes: a different matrix for each step.
            every = values if values.ndim == 3 else values[None]
            steps[name] = jnp.broadcast_to(every, (self.horizon, *every.shape[1:]))
        return Schedule(constants, steps)

    def initial(self, constants, noise):
        state, used, sizes = {}, 0, self.sizes
        for name, keys in self.starts:
            values = constants["start"][name]
            shape = jnp.shape(any_of(values))
            if keys == ("at",):
                state[name] = values["at"] + jnp.zeros(shape, noise.dtype)
                continue
            z = noise[used : used + sizes[name]].reshape(shape)
            used += sizes[name]
            if keys == ("low", "high"):
                share = 0.5 * (1 + jax.lax.erf(z * np.sqrt(0.5).astype(z.dtype)))
                state[name] = values["low"] + (values["high"] - values["low"]) * share
            else:
                state[name] = values["mean"] + values["deviation"] * z
        return self.read_off(constants, state, noise[used:])

    def observe(self, constants, now, state):
        # A state without readings is passed by a caller: it is observed exactly.
        displayed = {name: state[name] for name in self.states} | state.get(MEASURED, {})
        observed = self.features(constants["plant"], displayed)
        return jnp.append(observed, now["left"]) if self.time_feature else observed

    def step(self, constants, now, state, action, noise, smooth):
        after, result = self.unmeasured(constants, now, state, action, noise, smooth)
        errors = noise[noise.shape[0] - sum(self.sizes[name] for name in self.measured) :]
        return self.read_off(constants, after, errors), result

    def unmeasured(self, constants, now, state, action, noise, smooth):
        """The state after one step with its disturbances, not yet measured, and the outputs."""
        p = constants["plant"]
        u = self.drive(p, action)
        parts = self.cost(constants["cost"], p, state, u)
        return self.disturbed(now, self.move(p, state, u, smooth), noise), outputs(parts)

    def terminal(self, constants, state, smooth):
        parts = self.final_cost(constants["cost"], constants["plant"], state)
        return outputs(parts) if parts else {}

    def read_off(self, constants, state: PlantState, noise: Float[Array, " noise"]) -> PlantState:
        """The state with its measured values, which have independent errors."""
        if not self.measured:
            return state
        observed, used, sizes = {}, 0, self.sizes
        for name in self.measured:
            z = noise[used : used + sizes[name]].reshape(state[name].shape)
            used += sizes[name]
            observed[name] = state[name] + constants[MEASURED][name] * z
        return {**state, MEASURED: observed}  # pyright: ignore[reportReturnType]

    def disturbed(self, now, state: PlantState, noise: Float[Array, " noise"]) -> PlantState:
        """The state with the disturbances of this step: standard normals times a deviation or a
        matrix."""
        state, used = dict(state), 0
        for name in self.disturbed_parts:
            n = self.sizes[name]
            z = noise[used : used + n]
            used += n
            by = now[name]
            pushed = by @ z if by.ndim == 2 else by * z.reshape(state[name].shape)
            state[name] = state[name] + pushed
        return state


def outputs(parts: PlantState) -> PlantState:
    """The reward, minus all costs, and every cost by its name."""
    total = sum(parts.values(), jnp.zeros(()))
    return {"reward": -total, **{f"{name}_cost": value for name, value in parts.items()}}


StateVector = Mapping[str, Array]


def runge_kutta(
    slopes: Callable[[StateVector], StateVector], state: StateVector, dt
) -> dict[str, Array]:
    """The state after `dt`, by the classical method of order 4."""

    def ahead(by: StateVector, share) -> dict[str, Array]:
        return {name: state[name] + share * dt * by[name] for name in by}

    first = slopes(state)
    second = slopes(ahead(first, 0.5))
    third = slopes(ahead(second, 0.5))
    fourth = slopes(ahead(third, 1.0))
    mean = {n: (first[n] + 2 * second[n] + 2 * third[n] + fourth[n]) / 6 for n in first}
    return ahead(mean, 1.0)
