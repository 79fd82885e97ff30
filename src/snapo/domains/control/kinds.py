"""The descriptions of the kinds of plants: parameters, weights, states and actions with units.

The description is enough to read and check a case; the equations are in `plants/`, with a class for
each kind.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.problem.record.either import with_numpy, xp

PlantValues = Mapping[str, Any]


class PlantParameter(NamedTuple):
    """A parameter of a plant or of its cost: its default (None if it is required; infinite if
    there is no such limit), its unit and meaning. `positive`: whether it must be above 0."""

    value: Any
    unit: str
    description: str
    positive: bool = True


class Variable(NamedTuple):
    """A state or an action: its unit and meaning.

    - `start`: the default distribution of an initial state: {"at"}, {"low", "high"} or {"mean",
      "deviation"}.
    - `turn`: whether it is an angle, unwrapped in the state; its cost and features repeat
      every 2 pi.
    """

    unit: str
    description: str
    start: Mapping[str, Any] | None = None
    turn: bool = False


MEASURED = "measurement"  # key of the errors in the inputs, and of the readings in a state
SCALAR = "it must be one number, because this state is one number"
STARTS = (("at",), ("low", "high"), ("mean", "deviation"))  # a number; uniform; normal


class PlantKind:
    """The description of a plant."""

    type: ClassVar[str]
    description: ClassVar[str]
    parameters: ClassVar[Mapping[str, PlantParameter]]
    weights: ClassVar[Mapping[str, PlantParameter]]
    states: ClassVar[Mapping[str, Variable]]
    actions: ClassVar[Mapping[str, Variable]]
    steps: ClassVar[int]
    sees_time: ClassVar[bool] = False
    portrait: ClassVar[tuple[str, ...]] = ()  # two states to draw; the first two where empty
    twin: ClassVar[str] = ""  # the environment of Gymnasium with the same numbers
    rests: ClassVar[bool] = True  # it has a target: a linear rule around it is compared

    @classmethod
    def faults(cls, values: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
        """The contradictions in a case: (key, value, allowed). `values`: the numbers, grouped like
        the inputs."""
        for name, start in values["start"].items():
            if np.size(any_of(start)) > 1:
                yield f"start.{name}", any_of(start).tolist(), SCALAR
        for group in ("noise", MEASURED):
            for name, inputs in values[group].items():
                if np.ndim(inputs):
                    yield f"{group}.{name}", inputs.tolist(), SCALAR


def any_of(values: PlantValues) -> Any:
    """One of the arrays of a distribution, all of which have the shape of the state."""
    result = next(iter(values.values()))
    return getattr(result, "value", result)


class PendulumKind(PlantKind):
    """A rod that is driven by a motor."""

    type: ClassVar = "pendulum"
    description: ClassVar = "Pendulum-v1: swing up a rod and hold it upright"
    steps: ClassVar = 200
    twin: ClassVar = "Pendulum-v1"
    parameters: ClassVar = {
        "gravity": PlantParameter(10.0, "m/s2", "gravity"),
        "mass": PlantParameter(1.0, "kg", "mass of the rod"),
        "length": PlantParameter(1.0, "m", "length of the rod"),
        "torque": PlantParameter(2.0, "N m", "largest torque of the motor"),
        "max_speed": PlantParameter(8.0, "rad/s", "largest speed"),
        "step": PlantParameter(0.05, "s", "time step"),
    }
    weights: ClassVar = {
        "angle": PlantParameter(1.0, "1/rad2", "weight of the squared angle", False),
        "speed": PlantParameter(0.1, "s2/rad2", "weight of the squared speed", False),
        "torque": PlantParameter(0.001, "1/(N m)2", "weight of the squared torque", False),
    }
    states: ClassVar = {
        "angle": Variable("rad", "angle from upright", {"low": -np.pi, "high": np.pi}, True),
        "speed": Variable("rad/s", "angular speed", {"low": -1.0, "high": 1.0}),
    }
    actions: ClassVar = {"torque": Variable("N m", "torque of the motor")}


BOTTOM = -np.pi / 6  # of the valley


class MountainCarKind(PlantKind):
    """A car in a valley."""

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
        "goal": PlantParameter(0.45, "1", "position of the goal", False),
    }
    weights: ClassVar = {
        "prize": PlantParameter(100.0, "1", "prize at the goal", False),
        "effort": PlantParameter(0.1, "1", "weight of the squared action", False),
    }
    states: ClassVar = {
        "position": Variable("1", "position", {"low": -0.6, "high": -0.4}),
        "speed": Variable("1/step", "speed", {"at": 0.0}),
    }
    actions: ClassVar = {"action": Variable("1", "action as a share of the engine's power")}

    @classmethod
    def faults(cls, values):
        yield from super().faults(values)
        plant = values["plant"]
        if not plant["left"] < BOTTOM < plant["goal"] <= plant["right"]:
            message = f"it must be left < {BOTTOM:.3f} (the bottom of the valley) < goal <= right"
            yield "plant.goal", float(plant["goal"]), message


class CartPoleKind(PlantKind):
    """A rod on a cart."""

    type: ClassVar = "cart-pole"
    description: ClassVar = "a cart that swings its pole up and balances it"
    steps: ClassVar = 100
    portrait: ClassVar = ("angle", "spin")
    parameters: ClassVar = {
        "cart": PlantParameter(0.5, "kg", "mass of the cart"),
        "pole": PlantParameter(0.5, "kg", "mass of the pole"),
        "length": PlantParameter(0.6, "m", "length of the pole"),
        "friction": PlantParameter(0.1, "N s/m", "friction of the cart", False),
        "gravity": PlantParameter(9.82, "m/s2", "gravity"),
        "force": PlantParameter(10.0, "N", "largest force"),
        "step": PlantParameter(0.05, "s", "time step"),
    }
    weights: ClassVar = {
        "position": PlantParameter(0.5, "1/m2", "weight of the squared position", False),
        "angle": PlantParameter(1.0, "1", "weight of 2 (1 - cos angle)", False),
        "speed": PlantParameter(0.01, "s2/m2", "weight of the squared speed", False),
        "spin": PlantParameter(0.01, "s2/rad2", "weight of the squared spin", False),
        "force": PlantParameter(0.001, "1/N2", "weight of the squared force", False),
    }
    states: ClassVar = {
        "position": Variable("m", "position", {"mean": 0.0, "deviation": 0.1}),
        "angle": Variable("rad", "angle from upright", {"mean": np.pi, "deviation": 0.1}, True),
        "speed": Variable("m/s", "speed of the cart", {"mean": 0.0, "deviation": 0.1}),
        "spin": Variable("rad/s", "angular speed", {"mean": 0.0, "deviation": 0.1}),
    }
    actions: ClassVar = {"force": Variable("N", "force on the cart")}


class DoubleIntegratorKind(PlantKind):
    """A mass on a line."""

    type: ClassVar = "double-integrator"
    description: ClassVar = "a mass on a line, brought to rest by a bounded force"
    steps: ClassVar = 40
    sees_time: ClassVar = True
    parameters: ClassVar = {
        "mass": PlantParameter(1.0, "kg", "mass"),
        "force": PlantParameter(1.0, "N", "largest force"),
        "step": PlantParameter(0.2, "s", "time step"),
    }
    weights: ClassVar = {
        "position": PlantParameter(1.0, "1/m2", "weight of the squared position", False),
        "speed": PlantParameter(0.1, "s2/m2", "weight of the squared speed", False),
        "force": PlantParameter(0.1, "1/N2", "weight of the squared force", False),
        "final": PlantParameter(1.0, "1", "weight of the terminal state", False),
    }
    states: ClassVar = {
        "position": Variable("m", "position", {"mean": 1.0, "deviation": 0.5}),
        "speed": Variable("m/s", "speed", {"mean": 0.0, "deviation": 0.5}),
    }
    actions: ClassVar = {"force": Variable("N", "force")}


class LinearQuadraticKind(PlantKind):
    """A linear plant whose matrices are in the case."""

    type: ClassVar = "linear-quadratic"
    description: ClassVar = "a linear plant with a quadratic cost, with or without bounds"
    steps: ClassVar = 20
    sees_time: ClassVar = True
    parameters: ClassVar = {
        "A": PlantParameter(None, "1", "matrix from the state to the next state", False),
        "B": PlantParameter(None, "1", "matrix from the action to the next state", False),
        "limit": PlantParameter(math.inf, "1", "largest absolute value of an action"),
    }
    weights: ClassVar = {
        "Q": PlantParameter(None, "1", "weight matrix of the state", False),
        "R": PlantParameter(None, "1", "weight matrix of the action", False),
        "Q_T": PlantParameter(None, "1", "weight matrix of the terminal state", False),
    }
    states: ClassVar = {"x": Variable("1", "state")}
    actions: ClassVar = {"u": Variable("1", "action")}

    @classmethod
    def faults(cls, values):
        plant, cost = values["plant"], values["cost"]
        size = plant["A"].shape[0]
        actions = plant["B"].shape[-1]
        shapes = {
            "plant.A": (plant["A"], (size, size)), "plant.B": (plant["B"], (size, actions)),
            "cost.Q": (cost["Q"], (size, size)), "cost.Q_T": (cost["Q_T"], (size, size)),
            "cost.R": (cost["R"], (actions, actions)),
        }  # fmt: skip
        for key, (inputs, shape) in shapes.items():
            if inputs.shape != shape:
                message = f"it must be {shape[0]} rows of {shape[1]} numbers"
                yield key, inputs.tolist(), message
        for key in ("Q", "Q_T", "R"):
            inputs, minimum = cost[key], 1e-12 if key == "R" else -1e-9
            message = "it must be a symmetric matrix without negative eigenvalues"
            message = (
                "it must be a symmetric matrix with eigenvalues above 0" if key == "R" else message
            )
            if not np.allclose(inputs, inputs.T) or np.linalg.eigvalsh(inputs).min() < minimum:
                yield f"cost.{key}", inputs.tolist(), message
        for key, inputs in values["start"]["x"].items():
            if inputs.shape != (size,):
                yield f"start.x.{key}", inputs.tolist(), f"it must be {size} numbers"
        for inputs in values["noise"].values():
            if inputs.shape != (size, size):
                message = f"it must be {size} numbers, or {size} rows of {size} numbers"
                yield "noise.x", inputs.tolist(), message

        for inputs in values["measurement"].values():
            if inputs.shape != (size,):
                yield "measurement.x", inputs.tolist(), f"it must be {size} numbers"


def holding_flow(p):
    """The flow that holds the lower level at its target."""
    return p["lower"] * xp.sqrt(2 * p["gravity"] * p["target"])


class TwoTanksKind(PlantKind):
    """Two tanks and a pump."""

    type: ClassVar = "two-tanks"
    description: ClassVar = "two tanks and a pump that controls a level"
    steps: ClassVar = 60
    parameters: ClassVar = {
        "area": PlantParameter(15.0, "cm2", "cross section of a tank"),
        "upper": PlantParameter(0.18, "cm2", "cross section of the upper tank's outlet"),
        "lower": PlantParameter(0.18, "cm2", "cross section of the lower tank's outlet"),
        "gravity": PlantParameter(981.0, "cm/s2", "gravity"),
        "flow": PlantParameter(40.0, "cm3/s", "largest flow of the pump"),
        "height": PlantParameter(30.0, "cm", "height of a tank"),
        "target": PlantParameter(15.0, "cm", "target level in the lower tank"),
        "step": PlantParameter(2.0, "s", "time step"),
    }
    weights: ClassVar = {
        "level": PlantParameter(0.01, "1/cm2", "weight of the squared distance from the target "
        "level",
                          False),
        "pump": PlantParameter(0.02, "1", "weight of the squared change of the pump's flow from "
        "its flow at rest",
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
            message = f"it must be at most {maximum:.4g}: at a higher target a tank would overflow"
            yield "plant.target", float(plant["target"]), message
        holding = float(with_numpy(holding_flow)(plant))
        if holding > plant["flow"]:
            message = f"it must be at least {holding:.4g}, the flow that holds the target"
            yield "plant.flow", float(plant["flow"]), message


class QuadrotorKind(PlantKind):
    """Two rotors in the plane."""

    type: ClassVar = "quadrotor"
    description: ClassVar = "a quadrotor in the plane, flown to its target"
    steps: ClassVar = 80
    parameters: ClassVar = {
        "mass": PlantParameter(0.5, "kg", "mass"),
        "inertia": PlantParameter(0.002, "kg m2", "moment of inertia"),
        "arm": PlantParameter(0.15, "m", "distance of a rotor from the centre"),
        "gravity": PlantParameter(9.81, "m/s2", "gravity"),
        "thrust": PlantParameter(4.905, "N", "largest thrust of a rotor"),
        "step": PlantParameter(0.03, "s", "time step"),
    }
    weights: ClassVar = {
        "place": PlantParameter(
            1.0, "1/m2", "weight of the squared distance from the target", False
        ),
        "speed": PlantParameter(0.1, "s2/m2", "weight of the squared speed", False),
        "tilt": PlantParameter(0.1, "1/rad2", "weight of the squared tilt", False),
        "spin": PlantParameter(0.01, "s2/rad2", "weight of the squared spin", False),
        "thrust": PlantParameter(
            0.1, "1", "weight of the squared difference from the thrust of hovering", False
        ),
    }
    states: ClassVar = {
        "x": Variable("m", "position to the right", {"mean": 0.0, "deviation": 1.0}),
        "z": Variable("m", "height", {"mean": 0.0, "deviation": 1.0}),
        "tilt": Variable("rad", "tilt to the left", {"mean": 0.0, "deviation": 0.3}),
        "vx": Variable("m/s", "speed to the right", {"mean": 0.0, "deviation": 0.3}),
        "vz": Variable("m/s", "speed upward", {"mean": 0.0, "deviation": 0.3}),
        "spin": Variable("rad/s", "angular speed", {"mean": 0.0, "deviation": 0.3}),
    }
    actions: ClassVar = {
        "right": Variable("N", "thrust of the right rotor"),
        "left": Variable("N", "thrust of the left rotor"),
    }


KINDS: dict[str, type[PlantKind]] = {
    kind.type: kind
    for kind in (
        PendulumKind,
        MountainCarKind,
        CartPoleKind,
        DoubleIntegratorKind,
        LinearQuadraticKind,
        TwoTanksKind,
        QuadrotorKind,
    )
}
